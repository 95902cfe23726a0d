"""Frames and reports for the stations, kept until their time."""

from bisect import bisect_left
from collections.abc import Iterable
from itertools import count
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.frame import ECHO, ERROR, FRAME, Frames, frames

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


def records_of(burst: Frames) -> list[bytes]:
    """Return the records of frames one by one, as bytes."""
    packed, size = burst.tobytes(), FRAME.itemsize
    return [packed[first : first + size] for first in range(0, len(packed), size)]


def burst_of(records: Iterable[bytes]) -> Frames:
    """Return the frames of which these are the records."""
    return np.frombuffer(bytearray(b"".join(records)), FRAME)


class Outbox:
    """Records with their times, until they are collected."""

    def __init__(self) -> None:
        self._order = count()
        #: (time_ns, order, record, owner, audience, flags to set)
        self._entries: list[tuple[int, int, bytes, int, int, int]] = []

    def post(self, time_ns: int, record: bytes, owner: int, audience: int, flags: int = 0) -> None:
        """Post a frame for `time_ns`."""
        self._entries.append((time_ns, next(self._order), record, owner, audience, flags))

    def next_ns(self) -> int | None:
        """Return the earliest time of all posted records."""
        return min(self._entries)[0] if self._entries else None

    def collect(self, time_ns: int | None) -> Events:
        """Return all records posted up to `time_ns`; without a time, all records."""
        self._entries.sort()
        end = len(self._entries) if time_ns is None else bisect_left(self._entries, (time_ns + 1,))
        if not end:
            return _NOTHING
        times, _, records, owners, audiences, flags = zip(*self._entries[:end], strict=True)
        del self._entries[:end]
        collected = burst_of(records)
        collected["time_ns"] = times
        collected["expires_ns"] = 0  # matters to the sender only
        if any(flags):
            collected["flags"] |= np.array(flags, np.uint8)
        audience = np.array(audiences, np.uint8)
        plain = not any(flags) and min(audiences) == OTHERS | OWNER
        return Events(collected, np.array(owners), audience, plain)
