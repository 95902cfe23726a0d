"""The sampling instant of a cycle: when its SYNC ended on each bus.

Boards sample at the end of SYNC. The gateway knows two times of it: its own send call, and the time stamp of the echo.

    send call + time of the frame <= end of SYNC <= time stamp of the echo

because a frame waits for the frame that is on the bus, and an interrupt comes after the end of its frame. The wait is
rare, for the bus is free at the end of a window, and the latency of the interrupt is small beside the wait. So the time
stamp is the estimate, and the whole interval is the bound of its error. Where an interface gives no time stamps, or
echoes SYNC before SYNC has ended, the estimate is the send call plus the time of the frame, and the first frame that
names the cycle is the upper limit.

A time stamp that contradicts this order is of a clock that was set or is wrong: no bound is proven. On a virtual bus
the order does not hold, because a SYNC that was sent late ends as if sent when it was due. Nodes have the same time
stamp, so this time stamp is exact.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.told import NO_STAMPS
from canskin.messages import UNKNOWN_ERROR_NS
from dbc.contract import Contract, sync_frame
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns, nominal_ns
from dbc.frame_fields import Flags, Integers
from gateway.open_cycles import SLOTS, slot_of
from shell.compiled import njit


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


class SyncNotes(NamedTuple):
    """What the frames of the open cycles tell, by slot and bus.

    Attributes
    ----------
    echo_ns, answer_ns : arrays of int64, shape (SLOTS, buses)
        End of SYNC, and of its first answer, by their time stamps; 0 if there is none.
    stamp_error_ns : array of int64, shape (SLOTS, buses)
        Of the echo: bound of the error of its clock, `NO_STAMPS` if it has no time stamp.
    has_early_echo : array of bool, shape (buses,)
        Whether the interface may echo SYNC before SYNC has ended: the hand-over takes the place of the echo.
    """

    echo_ns: Integers
    answer_ns: Integers
    stamp_error_ns: Integers
    has_early_echo: Flags


@njit(cache=True, nogil=True)
def note_echo(slot: int, bus: int, time_ns: int, stamp_error_ns: int, notes: SyncNotes) -> bool:
    """Take note of the end of SYNC on a bus; tell whether it is the first of this cycle, as far as echoes tell."""
    if notes.has_early_echo[bus]:
        return True
    if notes.echo_ns[slot, bus]:
        return False
    notes.echo_ns[slot, bus], notes.stamp_error_ns[slot, bus] = time_ns, stamp_error_ns
    return True


@njit(cache=True, nogil=True)
def note_answer(slot: int, bus: int, time_ns: int, notes: SyncNotes) -> None:
    """Take note of a frame that answers SYNC on a bus; the first counts."""
    if not notes.answer_ns[slot, bus]:
        notes.answer_ns[slot, bus] = time_ns


class SyncTimes:
    """Times of the open cycles.

    Parameters
    ----------
    early_echoes : collection of int
        Numbers of the buses whose interface may echo a SYNC before it has been on the bus.

    Attributes
    ----------
    notes : SyncNotes
    """

    def __init__(self, contract: Contract, early_echoes: Collection[int] = ()) -> None:
        sync = sync_frame(1)
        #: Shortest time of a SYNC frame to its end.
        self._frame_ns = [
            int(frame_time_ns(sync, bus.bitrate, bus.data_bitrate, "none")[0])
            - nominal_ns(INTERMISSION_BITS, bus.bitrate)
            for bus in contract.layout.bus
        ]
        is_early = np.array([bus in early_echoes for bus in range(len(self._frame_ns))], np.bool_)
        echo_ns, answer_ns, stamp_error_ns = np.zeros((3, SLOTS, len(self._frame_ns)), np.int64)
        self.notes = SyncNotes(echo_ns, answer_ns, stamp_error_ns, is_early)
        #: By slot: when SYNC was due, and a time before the first send call; None in a replay.
        self._due_ns: list[int] = [0] * SLOTS
        self._sent_ns: list[int | None] = [None] * SLOTS

    def open(self, counter: int, due_ns: int, sent_ns: int | None) -> None:
        """Begin a cycle; `sent_ns` is a time before its SYNC is sent, None if nobody knows."""
        slot = slot_of(counter)
        self._due_ns[slot], self._sent_ns[slot] = due_ns, sent_ns
        notes = self.notes
        for noted in (notes.echo_ns, notes.answer_ns):
            noted[slot] = 0
        notes.echo_ns[slot, notes.has_early_echo] = max(due_ns if sent_ns is None else sent_ns, 1)
        notes.stamp_error_ns[slot] = NO_STAMPS

    def close(self, counter: int) -> SampledTimes:
        """End a cycle and return its sampling instant; if no bus has had its SYNC, when that was due."""
        slot = slot_of(counter)
        sent = self._sent_ns[slot]
        found = [
            self._end_of(sent, *told)
            for told in zip(self._frame_ns, *(noted[slot].tolist() for noted in self.notes[:3]), strict=True)
        ]
        bus_ns = np.array([end_ns for end_ns, _ in found], np.int64)
        sent_ns = 0 if sent is None else sent + sum(self._frame_ns) // len(self._frame_ns)
        known = [(end_ns, error_ns) for end_ns, error_ns in found if end_ns]
        if not known:
            return SampledTimes(sent_ns or self._due_ns[slot], UNKNOWN_ERROR_NS, sent_ns, bus_ns)
        first_ns = known[0][0]
        mono_ns = first_ns + round(sum(end_ns - first_ns for end_ns, _ in known) / len(known))
        if any(error_ns == UNKNOWN_ERROR_NS for _, error_ns in known):
            return SampledTimes(mono_ns, UNKNOWN_ERROR_NS, sent_ns, bus_ns)
        return SampledTimes(mono_ns, max(abs(end - mono_ns) + error for end, error in known), sent_ns, bus_ns)

    @staticmethod
    def _end_of(
        sent_ns: int | None, frame_ns: int, echo_ns: int, answer_ns: int, stamp_error_ns: int
    ) -> tuple[int, int]:
        """Return the end of SYNC on a bus, and the bound of its error; 0 if there was no SYNC."""
        if not echo_ns or sent_ns is None:
            return echo_ns, UNKNOWN_ERROR_NS
        earliest_ns = sent_ns + frame_ns
        if stamp_error_ns == NO_STAMPS:
            answer_late_ns = answer_ns - earliest_ns
            return earliest_ns, answer_late_ns if answer_late_ns >= 0 else UNKNOWN_ERROR_NS
        late_ns = echo_ns - earliest_ns
        # A clock without error is that of a virtual bus, whose stamp of a late SYNC is as if sent when it was due.
        if stamp_error_ns and late_ns < -stamp_error_ns:
            return echo_ns, UNKNOWN_ERROR_NS
        return echo_ns, max(0, late_ns) + stamp_error_ns
