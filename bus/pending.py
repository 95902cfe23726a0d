"""Frames that wait for the bus, in the order of arbitration."""

import heapq
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import int64

from bus.controller import Controller
from dbc.frame import CAN_ID_AT, EXPIRES_AT, EXTENDED, FLAGS_AT, REMOTE, TIME_AT, Frames
from dbc.frame_fields import ROWS, field
from shell.compiled import njit

_NEVER_NS: Final = 1 << 62


class Waiting(NamedTuple):
    """One frame in a transmit queue; tuples compare by `key`, then by `sequence`, which is unique."""

    key: int
    sequence: int
    record: bytes
    duration_ns: int
    controller: Controller
    expires_ns: int


class Pending:
    """All transmit queues of a bus as one queue in the order of arbitration, by identifier."""

    def __init__(self) -> None:
        self._ready: list[Waiting] = []
        self._future: list[tuple[int, Waiting]] = []
        self._parked: list[Waiting] = []
        #: Expired frames; the owner removes them.
        self.expired: list[Waiting] = []
        # No waiting frame expires before.
        self._expires_ns = _NEVER_NS

    def add(self, item: Waiting, release_ns: int) -> None:
        """Add `item`; it takes part in arbitration from `release_ns`."""
        heapq.heappush(self._future, (release_ns, item))
        if 0 < item.expires_ns < self._expires_ns:
            self._expires_ns = item.expires_ns

    def park(self, item: Waiting) -> None:
        """Keep `item` out of arbitration until `unpark`."""
        self._parked.append(item)

    def unpark(self, release_ns: int) -> None:
        """Return all parked frames to arbitration from `release_ns`."""
        for item in self._parked:
            self.add(item, release_ns)
        self._parked.clear()

    def next_start_ns(self, free_ns: int) -> int | None:
        """Return the start of the next frame on a bus that is idle from `free_ns`."""
        if self._ready:
            return free_ns
        return max(free_ns, self._future[0][0]) if self._future else None

    @property
    def ready_ns(self) -> int:
        """Time of the released frames that wait."""
        return sum(item.duration_ns for item in self._ready)

    def winner(self, start_ns: int) -> Waiting | None:
        """Remove and return the winner of the arbitration at `start_ns`; None if all ready frames have expired."""
        ready, future = self._ready, self._future
        while future and future[0][0] <= start_ns:
            heapq.heappush(ready, heapq.heappop(future)[1])
        if start_ns > self._expires_ns:
            self._expire(start_ns)
        return heapq.heappop(self._ready) if self._ready else None

    def _expire(self, start_ns: int) -> None:
        """Move the ready frames that have expired before `start_ns` to `expired`, however urgent the others are."""
        self.expired += sorted(item for item in self._ready if 0 < item.expires_ns < start_ns)
        self._ready = [item for item in self._ready if not 0 < item.expires_ns < start_ns]
        heapq.heapify(self._ready)
        waiting = [*self._ready, *(item for _, item in self._future)]
        self._expires_ns = min((item.expires_ns for item in waiting if item.expires_ns), default=_NEVER_NS)

    def contests(self, item: Waiting) -> bool:
        """Tell whether another frame with the same identifier is ready."""
        return bool(self._ready) and self._ready[0].key == item.key

    def equals(self, item: Waiting) -> list[Waiting]:
        """Remove and return other controllers' frames with the identifier of `item`: none of them loses."""
        equals: dict[Controller, Waiting] = {}
        kept: list[Waiting] = []
        while self.contests(item):
            other = heapq.heappop(self._ready)
            if other.controller is item.controller or other.controller in equals:
                kept.append(other)
            else:
                equals[other.controller] = other
        for other in kept:
            heapq.heappush(self._ready, other)
        return list(equals.values())

    def withdraw(self, controller: Controller) -> list[Waiting]:
        """Remove and return all frames of `controller`, oldest first."""
        waiting = [item for item in self._ready if item.controller is controller]
        waiting += [item for _, item in self._future if item.controller is controller]
        waiting += [item for item in self._parked if item.controller is controller]
        if waiting:
            self._ready = [item for item in self._ready if item.controller is not controller]
            self._future = [entry for entry in self._future if entry[1].controller is not controller]
            self._parked = [item for item in self._parked if item.controller is not controller]
            heapq.heapify(self._ready)
            heapq.heapify(self._future)
        return sorted(waiting, key=lambda item: item.sequence)


@njit(int64[:, ::1](ROWS, int64), cache=True, nogil=True)
def queueing(rows: npt.NDArray[np.uint8], now_ns: int) -> npt.NDArray[np.int64]:
    """Return arbitration key, release and expiry (0: none) of each frame, shape (3, n); the lowest key wins.

    A key is 32 bits in bus order (ISO 11898-1): base identifier 11, RTR or SRR 1, IDE 1, extension 18, RTR 1.
    So a standard frame beats an extended one with the same base, and data beats remote.

    Parameters
    ----------
    rows : array of uint8, shape (n, bytes of a FRAME)
    now_ns : int
        Release of frames without one. A release in the past is kept if the bus has been idle since: a sender that the
        host delayed is then as punctual on the bus as hardware would be.
    """
    queued = np.empty((3, len(rows)), np.int64)
    for place in range(len(rows)):
        row = rows[place]
        can_id = field(row, CAN_ID_AT, 4)
        remote = np.int64(row[FLAGS_AT] & REMOTE != 0)
        if row[FLAGS_AT] & EXTENDED:
            key = (can_id >> 18 & 0x7FF) << 21 | 3 << 19 | (can_id & 0x3FFFF) << 1 | remote
        else:
            key = (can_id & 0x7FF) << 21 | remote << 20
        release_ns = field(row, TIME_AT, 8)
        queued[0, place], queued[1, place] = key, release_ns if release_ns > 0 else now_ns
        queued[2, place] = field(row, EXPIRES_AT, 8)
    return queued


def clash_bits(same: Frames) -> int | None:
    """Return the approximate number of bits until frames with one identifier differ, None for equal frames."""
    first = same[0]
    if (same["length"] != first["length"]).any() or (same["flags"] != first["flags"]).any():
        return 19
    differs = (same["data"] != first["data"]).any(axis=0)
    return 19 + 8 * int(differs.argmax()) if differs.any() else None
