"""The figures of one skin, by the names under which Prometheus has them. Time is an argument; nothing is connected."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import accumulate
from math import inf, isfinite
from typing import Final, NamedTuple

import msgspec

from canskin.messages import SERVICES, TRUTH, GatewayStatus, Image, ServiceStatus
from canskin.peers import Peer
from health.state import TOPICS, ViewState
from skin.layout import Layout

#: Name of the exporter among the services.
SERVICE: Final = "exporter"
#: What a `SkinFigures` takes. Without the truth, which only says how exact simulated images are.
FIGURE_TOPICS: Final = frozenset({*TOPICS, SERVICES}) - {TRUTH}
GAUGE: Final = "gauge"
COUNTER: Final = "counter"
#: Upper bounds of the buckets of `LATENCY`, seconds.
BUCKETS_S: Final = (0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, inf)
LATENCY: Final = "canskin_sync_to_image_seconds"
#: Most causes of a skin at once, the worst first, and most names of services: both come from other programs.
CAUSES_MAX: Final = 128
SERVICES_MAX: Final = 64
#: Most characters of what a cause is about.
SUBJECT_MAX: Final = 200
#: What a service tells of itself once a second counts for this time.
TOLD_S: Final = 3.0
#: Node-IDs of CANopen (CiA 301).
_NODES: Final = range(1, 128)


class About(NamedTuple):
    """Type and labels of a figure beside ``skin``, and what it is."""

    kind: str
    labels: tuple[str, ...]
    words: str


FIGURES: Final = {
    "canskin_up": About(GAUGE, ("service",), "1 while an expected service is there, and sends what it has to."),
    "canskin_cause": About(GAUGE, ("code", "level", "subject"), "1 for each thing that is wrong now."),
    "canskin_cycles_total": About(COUNTER, (), "Cycles that have ended."),
    "canskin_cycles_complete_total": About(COUNTER, (), "Cycles in which every block was valid."),
    "canskin_syncs_skipped_total": About(COUNTER, (), "SYNCs that were not sent because they were too late."),
    "canskin_frames_total": About(COUNTER, ("fate",), "Frames by what the gateway did with them."),
    "canskin_bus_load_ratio": About(GAUGE, ("bus",), "Time of all frames / time, of the last 0.2 s."),
    "canskin_node_state": About(GAUGE, ("bus", "node"), "NMT state of a board: 5 operational, 255 silent."),
    "canskin_blocks_valid_ratio": About(GAUGE, (), "Part of the blocks that are valid in the newest image."),
    "canskin_doubtful_taxels": About(GAUGE, (), "Taxels whose force may be an error of the zero or of gains."),
    "canskin_service_memory_bytes": About(GAUGE, ("service",), "Resident memory."),
    "canskin_service_processor_seconds_total": About(COUNTER, ("service",), "Processor time of all threads."),
    "canskin_service_overruns_total": About(COUNTER, ("service",), "Messages for which a service was too slow."),
    "canskin_messages_missed_total": About(COUNTER, ("service",), "Messages that the fabric dropped."),
}
#: Of these figures a service tells its own, since the start of its process.
_TOLD: Final = {
    "canskin_service_processor_seconds_total": "processor_s",
    "canskin_service_overruns_total": "overruns",
    "canskin_messages_missed_total": "missed",
}


class Figure(NamedTuple):
    """A figure of `FIGURES`, the values of its labels, and its value."""

    name: str
    labels: tuple[str, ...]
    value: float


class SkinFigures:
    """What the messages of a skin tell for Prometheus.

    Parameters
    ----------
    layout : Layout
        Of the skin; messages that do not fit it are left out.
    expected : sequence of str
        Names of services that have to be there.
    epoch_s : float
        Wall-clock time of ``now_s = 0``.

    Attributes
    ----------
    buckets : list of int
        Number of images by latency, one for each of `BUCKETS_S`; `latency_s` is the sum of their latencies.
    """

    def __init__(self, layout: Layout, expected: Sequence[str], epoch_s: float = 0.0) -> None:
        self.buckets, self.latency_s = [0] * len(BUCKETS_S), 0.0
        self._expected = expected
        self._state = ViewState(layout, epoch_s, SERVICE)
        self._buses = {bus.name for bus in layout.bus}
        self._sampled_ns = 0
        self._gateway: GatewayStatus | None = None
        #: Of each process, what it told last, and when; of each service, the sums of its processes, also of ended ones.
        self._told: dict[str, tuple[ServiceStatus, float]] = {}
        self._sums: dict[str, Counter[str]] = {}

    def take_peer(self, peer: Peer, alive: bool, now_s: float) -> None:
        """Note that a service came or went at `now_s`."""
        self._state.take_peer(peer, alive, now_s)

    def take(self, message: msgspec.Struct, now_s: float) -> None:
        """Use a message of one of `FIGURE_TOPICS` that came at `now_s`."""
        if not self._state.take(message, now_s):
            return
        match message:
            case Image():
                self._time(message)
            case GatewayStatus():
                self._gateway = message
            case ServiceStatus():
                self._add(message, now_s)

    def _time(self, image: Image) -> None:
        """Count the latency of an image with new sums."""
        if not image.valid_sums or image.sampled_mono_ns == self._sampled_ns:
            return
        self._sampled_ns = image.sampled_mono_ns
        latency_s = max(0.0, (image.published_mono_ns - image.sampled_mono_ns) * 1e-9)
        self.buckets[bisect_left(BUCKETS_S, latency_s)] += 1
        self.latency_s += latency_s

    def _add(self, status: ServiceStatus, now_s: float) -> None:
        """Add what a process has taken since it told before: a counter of its service never goes back."""
        is_new = status.service not in self._sums
        if not isfinite(status.processor_s) or (is_new and len(self._sums) >= SERVICES_MAX):
            return
        before = self._told.pop(status.instance, None)
        sums = self._sums.setdefault(status.service, Counter())
        for name, field in _TOLD.items():
            sums[name] += max(0, getattr(status, field) - (getattr(before[0], field) if before else 0))
        self._told[status.instance] = status, now_s
        while len(self._told) > SERVICES_MAX:
            del self._told[next(iter(self._told))]

    def cumulated(self) -> list[tuple[float, int]]:
        """Return each of `BUCKETS_S` with the number of images up to there."""
        return list(zip(BUCKETS_S, accumulate(self.buckets), strict=True))

    def figures(self, now_s: float, undecodable: int = 0) -> Iterator[Figure]:
        """Yield all figures of `now_s` but the latencies; gauges of what is not known are left out."""
        state = self._state.snapshot(now_s, undecodable, is_single=True)[0]
        for name in self._expected:
            service = state.services.get(name)
            is_up = service is not None and service.alive and not service.silent and not state.cut_off
            yield Figure("canskin_up", (name,), is_up)
        causes = {(each.code, each.level, each.subject[:SUBJECT_MAX]) for each in state.notices[:CAUSES_MAX]}
        yield from (Figure("canskin_cause", labels, 1) for labels in causes)
        if state.image is not None and state.figures.valid_blocks is not None and state.figures.blocks:
            valid = 0 if state.image.stale else state.figures.valid_blocks
            yield Figure("canskin_blocks_valid_ratio", (), valid / state.figures.blocks)
        if self._gateway is not None:
            yield from self._counters(self._gateway)
            if state.gateway is not None and not state.gateway.stale:
                yield from self._gauges(self._gateway)
        yield from self._services(now_s)

    @staticmethod
    def _counters(status: GatewayStatus) -> Iterator[Figure]:
        yield Figure("canskin_cycles_total", (), status.cycles)
        yield Figure("canskin_cycles_complete_total", (), status.cycles_complete)
        yield Figure("canskin_syncs_skipped_total", (), status.syncs_skipped)
        fates = {**msgspec.structs.asdict(status.frames), "overrun": sum(bus.overrun for bus in status.buses)}
        yield from (Figure("canskin_frames_total", (fate,), count) for fate, count in fates.items())

    def _gauges(self, status: GatewayStatus) -> Iterator[Figure]:
        for name, bus in {bus.name: bus for bus in status.buses if bus.name in self._buses}.items():
            yield Figure("canskin_bus_load_ratio", (name,), bus.load_ratio)
            states = {node: nmt for node, nmt in zip(bus.nodes, bus.nmt, strict=True) if node in _NODES}
            yield from (Figure("canskin_node_state", (name, str(node)), nmt) for node, nmt in states.items())
        if status.calibration is not None:
            yield Figure("canskin_doubtful_taxels", (), status.calibration.doubtful_taxels)

    def _services(self, now_s: float) -> Iterator[Figure]:
        for service, sums in self._sums.items():
            yield from (Figure(name, (service,), value) for name, value in sums.items())
        memory: Counter[str] = Counter()
        for status, at_s in self._told.values():
            if now_s - at_s < TOLD_S:
                memory[status.service] += status.memory_bytes
        yield from (Figure("canskin_service_memory_bytes", (each,), taken) for each, taken in memory.items() if taken)
