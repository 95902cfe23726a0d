"""Frames and reports for the stations, kept until their time."""

from bisect import bisect_left
from collections.abc import Sequence
from itertools import count
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.frame import ECHO, ERROR, Frames, frames

#: Receivers of a record: all other stations, the station that sent the frame, or both.
OTHERS: Final = 1
OWNER: Final = 2
#: Flags of a frame that left its transmit queue unsent.
DISCARDED: Final = ECHO | ERROR


class Events(NamedTuple):
    """Frames and reports that ended on the bus, ordered by time.

    Attributes
    ----------
    frames : array of FRAME, shape (n,)
        `time_ns` is the end of frame, `port` the controller's number at its station. ECHO is not set.
    owner : array of int, shape (n,)
        Number of the station that sent the frame, or that receives the report.
    audience : array of uint8, shape (n,)
        OTHERS, OWNER or both.
    plain : bool
        Whether all records are frames for all stations.
    """

    frames: Frames
    owner: npt.NDArray[np.int64]
    audience: npt.NDArray[np.uint8]
    plain: bool


_NOTHING: Final = Events(frames(0), np.zeros(0, np.int64), np.zeros(0, np.uint8), plain=True)


class FramePool:
    """Slots for frames: `store` returns slot numbers, `take` returns the frames and frees the slots."""

    def __init__(self, size: int = 256) -> None:
        self.slots: Frames = frames(size)
        self._free = list(range(size))

    def store(self, burst: Frames) -> list[int]:
        """Copy `burst` into free slots and return their numbers, in order."""
        count = len(burst)
        while count > len(self._free):
            size = len(self.slots)
            grown = frames(2 * size)
            grown[:size] = self.slots
            self.slots = grown
            self._free.extend(range(size, 2 * size))
        taken = self._free[len(self._free) - count :]
        del self._free[len(self._free) - count :]
        self.slots[taken] = burst
        return taken

    def take(self, numbers: Sequence[int]) -> Frames:
        """Return a copy of the frames in these slots, and free them."""
        gathered: Frames = self.slots[list(numbers)]
        self._free.extend(numbers)
        return gathered


class Outbox:
    """Records with their times; frames stay in the pool's slots until they are collected."""

    def __init__(self, pool: FramePool) -> None:
        self._pool = pool
        self._order = count()
        #: (time_ns, order, slot, owner, audience, flags to set)
        self._entries: list[tuple[int, int, int, int, int, int]] = []

    def post(self, time_ns: int, slot: int, owner: int, audience: int, flags: int = 0) -> None:
        """Post the frame in `slot` for `time_ns`; `collect` frees the slot."""
        self._entries.append((time_ns, next(self._order), slot, owner, audience, flags))

    def post_copy(self, time_ns: int, record: Frames, owner: int, audience: int) -> None:
        """Post a frame without a slot."""
        self.post(time_ns, self._pool.store(record)[0], owner, audience)

    def next_ns(self) -> int | None:
        """Return the earliest time of all posted records."""
        return min(self._entries)[0] if self._entries else None

    def collect(self, time_ns: int | None) -> Events:
        """Return all records posted up to `time_ns`; without a time, all records."""
        self._entries.sort()
        end = len(self._entries) if time_ns is None else bisect_left(self._entries, (time_ns + 1,))
        if not end:
            return _NOTHING
        times, _, slots, owners, audiences, flags = zip(*self._entries[:end], strict=True)
        del self._entries[:end]
        collected = self._pool.take(slots)
        collected["time_ns"] = times
        collected["expires_ns"] = 0  # matters to the sender only
        if any(flags):
            collected["flags"] |= np.array(flags, np.uint8)
        audience = np.array(audiences, np.uint8)
        plain = not any(flags) and min(audiences) == OTHERS | OWNER
        return Events(collected, np.array(owners), audience, plain)
