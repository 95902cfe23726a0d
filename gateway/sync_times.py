"""The sampling instant of a cycle: when its SYNC ended on each bus.

Boards sample at the end of SYNC. The gateway knows two times of it: its own send call, and the time stamp of the echo.

    send call + time of the frame <= end of SYNC <= time stamp of the echo

because a frame waits for the frame that is on the bus, and an interrupt comes after the end of its frame. The wait is
rare, for the bus is free at the end of a window, and the latency of the interrupt is small beside the wait. So the time
stamp is the estimate, and the whole interval is the bound of its error. Where an interface gives no time stamps, the
estimate is the send call plus the time of the frame, and the first answer is the upper limit.

A time stamp that contradicts this order is of a clock that was set or is wrong: no bound is proven. On a virtual bus
the order does not hold, because a SYNC that was sent late ends as if sent when it was due. Nodes have the same time
stamp, so this time stamp is exact.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.messages import UNKNOWN_ERROR_NS
from dbc.contract import Contract
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns, nominal_ns


class SampledTimes(NamedTuple):
    """Sampling instant of a cycle; see `canskin.messages.Measurement`.

    Attributes
    ----------
    mono_ns, error_ns, sent_mono_ns : int
    bus_ns : array of int64, shape (buses,)
    """

    mono_ns: int
    error_ns: int
    sent_mono_ns: int
    bus_ns: npt.NDArray[np.int64]


@dataclass
class _Cycle:
    """What is known of one cycle, by bus.

    Attributes
    ----------
    due_ns : int
    sent_ns : int or None
        Before the first send call; None in a replay.
    echo_ns, answer_ns : list of int
        End of SYNC, and of its first answer, by their time stamps; 0 if there is none.
    stamp_error_ns : list of int or None
        Of the echo: bound of the error of its clock, None if it has no time stamp.
    """

    due_ns: int
    sent_ns: int | None
    echo_ns: list[int]
    answer_ns: list[int]
    stamp_error_ns: list[int | None]


class SyncTimes:
    """Takes note of the times of the open cycles; cycles are known by the counter of their SYNC."""

    def __init__(self, contract: Contract) -> None:
        self._cycles: dict[int, _Cycle] = {}
        sync = contract.sync(1)
        #: Shortest time of a SYNC frame to its end.
        self._frame_ns = [
            int(frame_time_ns(sync, bus.bitrate, bus.data_bitrate, "none")[0])
            - nominal_ns(INTERMISSION_BITS, bus.bitrate)
            for bus in contract.layout.bus
        ]

    def open(self, counter: int, due_ns: int, sent_ns: int | None) -> None:
        """Begin a cycle; `sent_ns` is a time before its SYNC is sent, None if nobody knows."""
        buses = len(self._frame_ns)
        self._cycles[counter] = _Cycle(due_ns, sent_ns, [0] * buses, [0] * buses, [None] * buses)

    def echo(self, counter: int, bus: int, time_ns: int, stamp_error_ns: int | None) -> None:
        """Take note of the end of SYNC on a bus; the first counts."""
        cycle = self._cycles.get(counter)
        if cycle is not None and not cycle.echo_ns[bus]:
            cycle.echo_ns[bus], cycle.stamp_error_ns[bus] = time_ns, stamp_error_ns

    def answer(self, counter: int, bus: int, time_ns: int) -> None:
        """Take note of a frame that answers SYNC on a bus; the first counts."""
        cycle = self._cycles.get(counter)
        if cycle is not None and not cycle.answer_ns[bus]:
            cycle.answer_ns[bus] = time_ns

    def close(self, counter: int) -> SampledTimes:
        """End a cycle and return its sampling instant; if no bus has had its SYNC, when that was due."""
        cycle = self._cycles.pop(counter)
        found = [self._end_of(cycle, bus) for bus in range(len(self._frame_ns))]
        bus_ns = np.array([end_ns for end_ns, _ in found], np.int64)
        sent_ns = 0 if cycle.sent_ns is None else cycle.sent_ns + sum(self._frame_ns) // len(self._frame_ns)
        known = [(end_ns, error_ns) for end_ns, error_ns in found if end_ns]
        if not known:
            return SampledTimes(sent_ns or cycle.due_ns, UNKNOWN_ERROR_NS, sent_ns, bus_ns)
        first_ns = known[0][0]
        mono_ns = first_ns + round(sum(end_ns - first_ns for end_ns, _ in known) / len(known))
        if any(error_ns == UNKNOWN_ERROR_NS for _, error_ns in known):
            return SampledTimes(mono_ns, UNKNOWN_ERROR_NS, sent_ns, bus_ns)
        return SampledTimes(mono_ns, max(abs(end - mono_ns) + error for end, error in known), sent_ns, bus_ns)

    def _end_of(self, cycle: _Cycle, bus: int) -> tuple[int, int]:
        """Return the end of SYNC on a bus, and the bound of its error; 0 if there was no SYNC."""
        echo_ns, stamp_error_ns = cycle.echo_ns[bus], cycle.stamp_error_ns[bus]
        if not echo_ns or cycle.sent_ns is None:
            return echo_ns, UNKNOWN_ERROR_NS
        earliest_ns = cycle.sent_ns + self._frame_ns[bus]
        if stamp_error_ns is None:
            answer_late_ns = cycle.answer_ns[bus] - earliest_ns
            return earliest_ns, answer_late_ns if answer_late_ns >= 0 else UNKNOWN_ERROR_NS
        late_ns = echo_ns - earliest_ns
        # A clock without error is that of a virtual bus, whose stamp of a late SYNC is as if sent when it was due.
        if stamp_error_ns and late_ns < -stamp_error_ns:
            return echo_ns, UNKNOWN_ERROR_NS
        return echo_ns, max(0, late_ns) + stamp_error_ns
