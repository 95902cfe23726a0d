"""All skins of a hub: each is joined as soon as its layout is told, and shown to whoever scrapes."""

import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from typing import Final

from prometheus_client import Histogram, disable_created_metrics
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from canskin.errors import SkinError
from canskin.fabric import Fabric
from canskin.peers import Peer
from canskin.session import Stop
from health.causes import INFO, Cause
from health.feed import Feed
from shell.service import say
from shell.skin_options import hub_layout, join, knows_layout
from skin.layout import Layout
from views.metrics.skin_figures import FIGURE_TOPICS, FIGURES, SERVICE, Figure, SkinFigures

#: Most skins; whoever may open the hub may invent names.
SKINS_MAX: Final = 16
#: Period of the search for skins.
SEARCH_S: Final = 1.0
#: A skin that could not be joined is tried again after this time.
AGAIN_S: Final = 30.0
LATENCY: Final = "canskin_sync_to_image_seconds"
#: Upper bounds of the buckets of `LATENCY`.
BUCKETS_S: Final = (0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1)


class _Skin:
    """A running skin: the fabric's threads bring the messages, and others ask for the figures."""

    def __init__(self, layout: Layout, figures: SkinFigures, endpoint: str, stop: Stop) -> None:
        self._figures = figures
        self.fabric = join(layout, SERVICE, endpoint, stop=stop, prepare=self._prepare)

    def figures(self) -> list[Figure]:
        missed = sum(self.fabric.missed.counts().values())
        with self._feed.lock:
            found = list(self._figures.figures(self._feed.read(), self._feed.malformed))
        return [*found, ("canskin_messages_missed_total", (SERVICE,), missed)]

    def _prepare(self, fabric: Fabric) -> None:
        self._feed = Feed(fabric, FIGURE_TOPICS, self._figures.take, self._figures.take_peer)


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
        self._skins: dict[str, _Skin] = {}
        self._fingerprints: dict[str, str] = {}
        self._again_s: dict[str, float] = {}
        #: Skin, code, level and subject of each cause at the newest look.
        self._told: set[tuple[str, ...]] = set()
        disable_created_metrics()
        words = "Time from SYNC to the publication of an image."
        self._latencies = Histogram(LATENCY, words, ("skin",), buckets=BUCKETS_S, registry=None)

    def run(self, stop: Stop) -> None:
        """Join each skin that comes, until `stop`; a skin that goes stays, with its services gone."""
        with closing(Fabric("-", "", self._endpoint, stop=stop)) as lobby:
            while not stop.is_set():
                for peer in filter(knows_layout, lobby.peers()):
                    self._see(peer, stop)
                due_s = time.monotonic() + SEARCH_S
                while time.monotonic() < due_s and not stop.is_set():
                    time.sleep(0.05)

    def close(self) -> None:
        """Leave all skins."""
        for skin in self._skins.values():
            skin.fabric.close()

    def collect(self) -> Iterable[Metric]:
        """Yield each figure with its values of all skins."""
        families = {
            name: (CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily)(
                name, words, labels=("skin", *labels)
            )
            for name, (labels, words) in FIGURES.items()
        }
        told, self._told = self._told, set()
        for skin, joined in list(self._skins.items()):
            for name, labels, value in joined.figures():
                families[name].add_metric((skin, *labels), value)
                if name == "canskin_cause" and INFO not in labels:
                    self._told.add((skin, *labels))
        for skin, code, _, subject in sorted(self._told - told):
            say(SERVICE, f"skin '{skin}': {Cause.of(code).sees}{f': {subject}' * bool(subject)} [{code}]")
        words = "Each cause: what is seen, and what to do."
        causes = GaugeMetricFamily("canskin_cause_info", words, labels=("code", "sees", "mend"))
        for cause in Cause:
            causes.add_metric((cause.code, cause.sees, cause.mend.format(subject="it")), 1)
        yield from (*families.values(), *self._latencies.collect(), causes)

    def _see(self, peer: Peer, stop: Stop) -> None:
        """Join the skin of a service that tells the layout, unless this has happened with this layout."""
        known, now_s = self._skins.get(peer.skin), time.monotonic()
        if known is not None and self._fingerprints[peer.skin] == peer.fingerprint:
            return
        if now_s < self._again_s.get(peer.skin, now_s) or (known is None and len(self._skins) >= SKINS_MAX):
            return
        try:
            layout = hub_layout(self._endpoint, peer.skin, stop, service=SERVICE)
            observe = self._latencies.labels(peer.skin).observe
            figures = SkinFigures(layout, self._expected, observe, time.time() - time.monotonic())
            skin = _Skin(layout, figures, self._endpoint, stop)
        except SkinError as error:
            waiting = {skin: at_s for skin, at_s in self._again_s.items() if at_s > now_s}  # others may invent names
            self._again_s = waiting | {peer.skin: now_s + AGAIN_S}
            say(SERVICE, f"skin '{peer.skin}' is not shown: {error}")
            return
        self._skins[peer.skin], self._fingerprints[peer.skin] = skin, peer.fingerprint
        say(SERVICE, f"skin '{peer.skin}' {'has another layout' if known else 'is shown'}")
        if known is not None:
            known.fabric.close()
