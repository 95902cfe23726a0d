"""All skins of a hub: each is joined as soon as its layout is told, and shown to whoever scrapes."""

import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from typing import Final

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from canskin.errors import SkinError
from canskin.fabric import Fabric
from canskin.peers import Peer
from canskin.session import Stop
from health.backlog import Backlog
from health.causes import Cause
from shell.service import RateLimitedLog, say
from shell.skin_options import hub_layout, join, knows_layout
from skin.layout import Layout
from views.metrics.skin_figures import COUNTER, FIGURE_TOPICS, FIGURES, LATENCY, SERVICE, Figure, SkinFigures

#: Most skins; whoever may open the hub may invent names.
SKINS_MAX: Final = 16
#: Period of the search for skins.
SEARCH_S: Final = 1.0
#: A skin that could not be joined is tried again after this time.
AGAIN_S: Final = 30.0


class Joined:
    """A running skin: the fabric's threads bring the messages, and others ask for the figures."""

    def __init__(self, layout: Layout, fingerprint: str, expected: Sequence[str]) -> None:
        self.name, self.fingerprint = layout.name, fingerprint
        self.fabric: Fabric | None = None
        self._figures = SkinFigures(layout, expected, time.time() - time.monotonic())
        self._lock = threading.RLock()
        self._backlog = Backlog(self._figures.take, self._lock)

    def prepare(self, fabric: Fabric) -> None:
        """Subscribe to all that is shown."""
        self._backlog.join(fabric, FIGURE_TOPICS)
        fabric.watch_peers(self._changed)

    def figures(self) -> tuple[list[Figure], list[tuple[str, int]], float]:
        """Return all figures of now, the buckets of the latencies, and their sum."""
        fabric = self.fabric
        with self._lock:
            now_s = self._backlog.read()
            found = list(self._figures.figures(now_s, fabric.malformed if fabric else 0))
            buckets = [(f"{bound_s:g}".replace("inf", "+Inf"), count) for bound_s, count in self._figures.cumulated()]
            latency_s = self._figures.latency_s
        if fabric is not None:
            missed = sum(fabric.missed.counts().values())
            found.append(Figure("canskin_messages_missed_total", (SERVICE,), missed))
        return found, buckets, latency_s

    def close(self) -> None:
        """Leave the skin."""
        if self.fabric is not None:
            self.fabric.close()

    def _changed(self, peer: Peer, alive: bool) -> None:
        with self._lock:
            self._figures.take_peer(peer, alive, time.monotonic())


class Exporter(Collector):
    """Joins the skins of a hub, and collects their figures.

    Parameters
    ----------
    endpoint : str
        Of the hub.
    expected : sequence of str
        Names of the services that each skin has to have.
    """

    def __init__(self, endpoint: str, expected: Sequence[str]) -> None:
        self._endpoint, self._expected = endpoint, expected
        self._skins: dict[str, Joined] = {}
        self._again_s: dict[str, float] = {}
        self._log = RateLimitedLog(SERVICE)

    def run(self, stop: Stop) -> None:
        """Join each skin that comes, until `stop`; a skin that goes stays, with its services gone."""
        with closing(Fabric("-", "", self._endpoint, stop=stop)) as lobby:
            while not stop.is_set():
                for peer in lobby.peers():
                    if knows_layout(peer):
                        self._see(peer, stop)
                due_s = time.monotonic() + SEARCH_S
                while time.monotonic() < due_s and not stop.is_set():
                    time.sleep(0.05)

    def close(self) -> None:
        """Leave all skins."""
        for skin in self._skins.values():
            skin.close()

    def _see(self, peer: Peer, stop: Stop) -> None:
        """Join the skin of a service that tells the layout, unless this has happened with this layout."""
        known, now_s = self._skins.get(peer.skin), time.monotonic()
        if known is not None and known.fingerprint == peer.fingerprint:
            return
        if now_s < self._again_s.get(peer.skin, now_s) or (known is None and len(self._skins) >= SKINS_MAX):
            return
        try:
            layout = hub_layout(self._endpoint, peer.skin, stop)
            skin = Joined(layout, peer.fingerprint, self._expected)
            skin.fabric = join(layout, SERVICE, self._endpoint, stop=stop, prepare=skin.prepare)
        except SkinError as error:
            self._again_s[peer.skin] = now_s + AGAIN_S
            self._log.say(f"skin '{peer.skin}' is not shown: {error}")
            return
        self._skins[peer.skin] = skin
        say(SERVICE, f"skin '{peer.skin}' {'has another layout' if known else 'is shown'}")
        if known is not None:
            known.close()

    def collect(self) -> Iterable[Metric]:
        """Yield each figure with its values of all skins."""
        families = {
            name: (CounterMetricFamily if about.kind == COUNTER else GaugeMetricFamily)(
                name, about.words, labels=("skin", *about.labels)
            )
            for name, about in FIGURES.items()
        }
        latencies = HistogramMetricFamily(LATENCY, "Time from SYNC to the publication of an image.", labels=("skin",))
        for skin in list(self._skins.values()):
            figures, buckets, latency_s = skin.figures()
            for each in figures:
                families[each.name].add_metric((skin.name, *each.labels), each.value)
            latencies.add_metric((skin.name,), buckets, latency_s)
        causes = GaugeMetricFamily(
            "canskin_cause_info", "Each cause: what is seen, and what to do.", labels=("code", "sees", "mend")
        )
        for cause in Cause:
            causes.add_metric((cause.code, cause.sees, cause.mend.format(subject="it")), 1)
        yield from (*families.values(), latencies, causes)
