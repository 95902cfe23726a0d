"""The figures of one skin, by the names under which Prometheus has them. Time is an argument; nothing is connected."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import msgspec

from canskin.messages import TRUTH, GatewayStatus, Image
from canskin.peers import Peer
from health.state import TOPICS, ViewState
from skin.layout import Layout

#: Name of the exporter among the services.
SERVICE: Final = "exporter"
#: What a `SkinFigures` takes. Without the truth, which only says how exact simulated images are.
FIGURE_TOPICS: Final = frozenset(TOPICS) - {TRUTH}
#: By name: labels beside ``skin``, and what it is. Names that end in ``_total`` are counters, the others gauges.
FIGURES: Final[dict[str, tuple[tuple[str, ...], str]]] = {
    "canskin_up": (("service",), "1 while an expected service is there, and sends what it has to."),
    "canskin_cause": (("code", "level", "subject"), "1 for each thing that is wrong now."),
    "canskin_cycles_total": ((), "Cycles that have ended."),
    "canskin_cycles_complete_total": ((), "Cycles in which every block was valid."),
    "canskin_syncs_skipped_total": ((), "SYNCs that were not sent because they were too late."),
    "canskin_frames_total": (("fate",), "Frames by what the gateway did with them."),
    "canskin_bus_load_ratio": (("bus",), "Time of all frames / time, of the last 0.2 s."),
    "canskin_node_state": (("bus", "node"), "NMT state of a board: 5 operational, 255 silent."),
    "canskin_blocks_valid_ratio": ((), "Part of the blocks that are valid in the newest image."),
    "canskin_doubtful_taxels": ((), "Taxels whose force may be an error of the zero or of gains."),
    "canskin_service_memory_bytes": (("service",), "Resident memory."),
    "canskin_service_processor_seconds_total": (("service",), "Processor time of all threads."),
    "canskin_service_overruns_total": (("service",), "Messages for which a service was too slow."),
    "canskin_messages_missed_total": (("service",), "Messages that the fabric dropped."),
    "canskin_clock_error_seconds": (("service",), "Bound of the error of the gateway's clock, as a service knows it."),
}
#: Of these a service tells its own, in a field of `health.snapshot.Service`.
_TOLD: Final = {
    "canskin_service_memory_bytes": "memory_bytes",
    "canskin_service_processor_seconds_total": "processor_s",
    "canskin_service_overruns_total": "overruns",
    "canskin_messages_missed_total": "missed",
    "canskin_clock_error_seconds": "clock_error_s",
}
#: Most causes of a skin at once, the worst first: other programs name what they are about.
CAUSES_MAX: Final = 128
#: Most characters of what a cause is about.
SUBJECT_MAX: Final = 200
#: Node-IDs of CANopen (CiA 301).
_NODES: Final = range(1, 128)

#: Name, values of the labels, and value.
Figure = tuple[str, tuple[str, ...], float]


class SkinFigures:
    """What the messages of a skin tell for Prometheus.

    Parameters
    ----------
    layout : Layout
        Of the skin; messages that do not fit it are left out.
    expected : sequence of str
        Names of services that have to be there.
    observe : callable
        Called with the time from SYNC to the publication of each image with new sums, seconds.
    epoch_s : float
        Wall-clock time of ``now_s = 0``.
    """

    def __init__(
        self, layout: Layout, expected: Sequence[str], observe: Callable[[float], None], epoch_s: float = 0.0
    ) -> None:
        self._expected, self._observe = expected, observe
        self._state = ViewState(layout, epoch_s, SERVICE)
        self._buses = {bus.name for bus in layout.bus}
        self._sampled_ns = 0
        self._gateway: GatewayStatus | None = None

    def take_peer(self, peer: Peer, alive: bool, now_s: float) -> None:
        """Note that a service came or went at `now_s`."""
        self._state.take_peer(peer, alive, now_s)

    def take(self, message: msgspec.Struct, now_s: float) -> None:
        """Use a message of one of `FIGURE_TOPICS` that came at `now_s`."""
        if not self._state.take(message, now_s):
            return
        match message:
            case Image() if message.valid_sums and message.sampled_mono_ns != self._sampled_ns:
                self._sampled_ns = message.sampled_mono_ns
                self._observe(max(0.0, (message.published_mono_ns - message.sampled_mono_ns) * 1e-9))
            case GatewayStatus():
                self._gateway = message

    def figures(self, now_s: float, undecodable: int = 0) -> Iterator[Figure]:
        """Yield all figures of `now_s`; gauges of what is not known are left out."""
        state = self._state.snapshot(now_s, undecodable, is_single=True)[0]
        for name in self._expected:
            service = state.services.get(name)
            is_up = service is not None and service.alive and not service.silent and not state.cut_off
            yield "canskin_up", (name,), is_up
        causes = {(each.code, each.level, each.subject[:SUBJECT_MAX]) for each in state.notices[:CAUSES_MAX]}
        yield from (("canskin_cause", labels, 1) for labels in causes)
        if state.image is not None and state.figures.valid_blocks is not None and state.figures.blocks:
            valid = 0 if state.image.stale else state.figures.valid_blocks
            yield "canskin_blocks_valid_ratio", (), valid / state.figures.blocks
        if self._gateway is not None:
            yield from self._counters(self._gateway)
            if state.gateway is not None and not state.gateway.stale:
                yield from self._gauges(self._gateway)
        for name, service in state.services.items():
            told = ((figure, getattr(service, field)) for figure, field in _TOLD.items())
            yield from ((figure, (name,), value) for figure, value in told if value is not None)

    @staticmethod
    def _counters(status: GatewayStatus) -> Iterator[Figure]:
        yield "canskin_cycles_total", (), status.cycles
        yield "canskin_cycles_complete_total", (), status.cycles_complete
        yield "canskin_syncs_skipped_total", (), status.syncs_skipped
        fates = {**msgspec.structs.asdict(status.frames), "overrun": sum(bus.overrun for bus in status.buses)}
        yield from (("canskin_frames_total", (fate,), count) for fate, count in fates.items())

    def _gauges(self, status: GatewayStatus) -> Iterator[Figure]:
        for name, bus in {bus.name: bus for bus in status.buses if bus.name in self._buses}.items():
            yield "canskin_bus_load_ratio", (name,), bus.load_ratio
            states = {node: nmt for node, nmt in zip(bus.nodes, bus.nmt, strict=True) if node in _NODES}
            yield from (("canskin_node_state", (name, str(node)), nmt) for node, nmt in states.items())
        if status.calibration is not None:
            yield "canskin_doubtful_taxels", (), status.calibration.doubtful_taxels
