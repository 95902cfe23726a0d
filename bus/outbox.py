"""Frames and reports for the stations, kept until their time."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.arbitration import (
    AUDIENCE,
    DISCARDED,
    EVENT_WORDS,
    EXPIRES,
    FOREVER_NS,
    FRAME_WORDS,
    OTHERS,
    OWNED_BY,
    OWNER,
    TIME,
    Words,
    words,
)
from dbc.frame import FRAME, Frames, frames

__all__ = ["DISCARDED", "OTHERS", "OWNER", "Events", "Outbox"]


class Events(NamedTuple):
    """Frames and reports that ended on the bus, ordered by time.

    Attributes
    ----------
    frames : array of FRAME, shape (n,)
        `time_ns` is the end of frame, `port` the controller's number at its station. ECHO is not set.
    owner : array of int, shape (n,)
        Number of the station that sent the frame, or that receives the report.
    audience : array of int, shape (n,)
        OTHERS, OWNER or both.
    plain : bool
        Whether all records are frames for all stations.
    """

    frames: Frames
    owner: npt.NDArray[np.int64]
    audience: npt.NDArray[np.integer]
    plain: bool


_NOTHING: Final = Events(frames(0), np.zeros(0, np.int64), np.zeros(0, np.int64), plain=True)


class Outbox:
    """Records with their times, until they are collected.

    Attributes
    ----------
    next_ns : int or None
        The earliest time of all posted records.
    """

    def __init__(self) -> None:
        self.next_ns: int | None = None
        self._posted: list[Words] = []

    def post(self, burst: Frames, time_ns: int | Words, owner: int, audience: int) -> None:
        """Post frames of a station for `time_ns`."""
        events = np.zeros((len(burst), EVENT_WORDS), np.int64)
        events[:, :FRAME_WORDS] = words(burst)
        events[:, TIME], events[:, EXPIRES], events[:, OWNED_BY], events[:, AUDIENCE] = time_ns, 0, owner, audience
        self.add(events[np.argsort(events[:, TIME], kind="stable")])

    def add(self, events: Words) -> None:
        """Post records, shape (n, EVENT_WORDS), ascending by time."""
        if len(events):
            first_ns = int(events[0, TIME])
            self.next_ns = first_ns if self.next_ns is None else min(first_ns, self.next_ns)
            self._posted.append(events)

    def collect(self, time_ns: int = FOREVER_NS) -> Events:
        """Return all records posted up to `time_ns`."""
        if self.next_ns is None or self.next_ns > time_ns:
            return _NOTHING
        events = self._posted[0]
        if len(self._posted) > 1:
            events = np.concatenate(self._posted)
            events = events[np.argsort(events[:, TIME], kind="stable")]
        end = int(np.searchsorted(events[:, TIME], time_ns, "right"))
        self._posted = [events[end:]] if end < len(events) else []
        self.next_ns = int(events[end, TIME]) if end < len(events) else None
        ended, audience = events[:end], events[:end, AUDIENCE]
        burst: Frames = np.ndarray(end, FRAME, np.ascontiguousarray(ended[:, :FRAME_WORDS]))
        return Events(burst, ended[:, OWNED_BY], audience, bool((audience == OTHERS | OWNER).all()))
