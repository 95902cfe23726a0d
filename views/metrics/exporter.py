"""All skins of a hub: each is joined as soon as its layout is told, and shown to whoever scrapes."""

import time
from collections.abc import Iterable, Sequence
from typing import Final

from prometheus_client import Histogram, disable_created_metrics
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from canskin.fabric import Fabric
from canskin.session import Stop
from health.causes import INFO, Cause
from health.feed import Feed
from health.skins import Skins
from shell.service import say
from shell.skin_options import join
from skin.layout import Layout
from views.metrics.skin_figures import FIGURE_TOPICS, FIGURES, SERVICE, Figure, SkinFigures

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

    def close(self) -> None:
        self.fabric.close()

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
        self._skins = Skins(endpoint, SERVICE, self._join)
        #: Skin, code, level and subject of each cause at the newest look.
        self._told: set[tuple[str, ...]] = set()
        disable_created_metrics()
        words = "Time from SYNC to the publication of an image."
        self._latencies = Histogram(LATENCY, words, ("skin",), buckets=BUCKETS_S, registry=None)

    def run(self, stop: Stop) -> None:
        """Join each skin that comes, until `stop`."""
        self._skins.run(stop)

    def close(self) -> None:
        """Leave all skins."""
        self._skins.close()

    def collect(self) -> Iterable[Metric]:
        """Yield each figure with its values of all skins."""
        families = {
            name: (CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily)(
                name, words, labels=("skin", *labels)
            )
            for name, (labels, words) in FIGURES.items()
        }
        told, self._told = self._told, set()
        for skin, joined in list(self._skins.joined.items()):
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

    def _join(self, layout: Layout, stop: Stop) -> _Skin:
        observe = self._latencies.labels(layout.name).observe
        figures = SkinFigures(layout, self._expected, observe, time.time() - time.monotonic())
        return _Skin(layout, figures, self._endpoint, stop)
