"""Frames and reports for the stations, kept until their time."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.arbitration import DISCARDED, EVENT, FOREVER_NS, OTHERS, OWNER
from dbc.frame import Frames, frames

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
        self._posted: list[npt.NDArray[np.void]] = []

    def post(self, burst: Frames, time_ns: int | npt.NDArray[np.int64], owner: int, audience: int) -> None:
        """Post frames of a station for `time_ns`."""
        events = np.zeros(len(burst), EVENT)
        events["frame"], events["owner"], events["audience"] = burst, owner, audience
        events["frame"]["time_ns"], events["frame"]["expires_ns"] = time_ns, 0
        self.add(events[np.argsort(events["frame"]["time_ns"], kind="stable")])

    def add(self, events: npt.NDArray[np.void]) -> None:
        """Post an array of EVENT, ascending by time."""
        if len(events):
            first_ns = int(events["frame"]["time_ns"][0])
            self.next_ns = first_ns if self.next_ns is None else min(first_ns, self.next_ns)
            self._posted.append(events)

    def collect(self, time_ns: int = FOREVER_NS) -> Events:
        """Return all records posted up to `time_ns`."""
        if self.next_ns is None or self.next_ns > time_ns:
            return _NOTHING
        events = self._posted[0] if len(self._posted) == 1 else np.concatenate(self._posted)
        times_ns = events["frame"]["time_ns"]
        if (times_ns[1:] < times_ns[:-1]).any():
            events = events[np.argsort(times_ns, kind="stable")]
            times_ns = events["frame"]["time_ns"]
        end = int(np.searchsorted(times_ns, time_ns, "right"))
        self._posted = [events[end:]] if end < len(events) else []
        self.next_ns = int(times_ns[end]) if end < len(events) else None
        ended = events[:end]
        return Events(
            ended["frame"].copy(), ended["owner"], ended["audience"], bool((ended["audience"] == OTHERS | OWNER).all())
        )
