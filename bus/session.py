"""One client's connection as the process of a bus sees it: what it may hear, and what waits for it."""

import socket
from collections import deque
from typing import Final

import numpy as np
import numpy.typing as npt

from bus.outbox import OTHERS, OWNER, Events
from bus.protocol import HEADER, MAGIC, MAX_FRAMES, Filter, Kind
from bus.station import Station
from dbc.frame import ECHO, ERROR, EXTENDED, Frames

#: Received frames that wait in this process for a client that does not read; later ones are lost, and counted.
BACKLOG_FRAMES: Final = 16384


class Session:
    """A station and its socket.

    The backlog is bounded: received frames by `BACKLOG_FRAMES`, echoes, which are never dropped, by the transmit
    queues they return credit to.
    """

    def __init__(self, connection: socket.socket, station: Station, filters: tuple[Filter, ...] = ()) -> None:
        self.connection = connection
        self.station = station
        self.dropped = 0
        self._filters = filters
        self._backlog: deque[Frames] = deque()
        self._waiting = 0

    def fileno(self) -> int:
        """Return the socket's descriptor, for select."""
        return self.connection.fileno()

    @property
    def blocked(self) -> bool:
        """Whether frames wait until the client reads."""
        return bool(self._backlog)

    def offer(self, events: Events, now_ns: int) -> None:
        """Send the client what concerns it."""
        chosen = self._select(events)
        if not len(chosen):
            return
        for first in range(0, len(chosen), MAX_FRAMES):
            part = chosen[first : first + MAX_FRAMES]
            if self._backlog or not self._send(part, now_ns):
                self._keep(part)

    def flush(self, now_ns: int) -> None:
        """Send what waits, as far as the client reads."""
        while self._backlog and self._send(self._backlog[0], now_ns):
            self._waiting -= int(np.count_nonzero(self._backlog.popleft()["flags"] & ECHO == 0))

    def _send(self, part: Frames, now_ns: int) -> bool:
        state = self.station.state
        header = HEADER.pack(MAGIC, Kind.FRAMES, state, len(part), self.dropped, now_ns)
        try:
            self.connection.sendmsg([header, part.tobytes()])
        except BlockingIOError:
            return False
        return True

    def _keep(self, part: Frames) -> None:
        """Let frames wait; drop received ones that exceed the bound."""
        received = part["flags"] & ECHO == 0
        excess = np.cumsum(received) > BACKLOG_FRAMES - self._waiting
        lost = received & excess
        self.dropped += int(lost.sum())
        kept = part[~lost]
        self._waiting += int(received.sum() - lost.sum())
        if not len(kept):
            return
        if self._backlog and len(self._backlog[-1]) + len(kept) <= MAX_FRAMES:
            self._backlog[-1] = np.concatenate((self._backlog[-1], kept))
        else:
            self._backlog.append(kept)

    def _select(self, events: Events) -> Frames:
        """Choose the records for this station, and mark its own frames as echoes."""
        mine = events.owner == self.station.number
        if not mine.any():
            wanted = (events.audience & OTHERS != 0) & self._passes(events.frames)
            chosen: Frames = events.frames[wanted]
            chosen["port"] = 0
            return chosen[:0] if self.station.off else chosen
        theirs = (events.audience & OTHERS != 0) & self._passes(events.frames) & (not self.station.off)
        keep = np.where(mine, events.audience & OWNER != 0, theirs)
        chosen, own = events.frames[keep], mine[keep]
        chosen["port"][~own] = 0
        chosen["flags"][own & (chosen["flags"] & ERROR == 0)] |= ECHO
        return chosen

    def _passes(self, arrived: Frames) -> npt.NDArray[np.bool_]:
        """Tell which frames the client's filters let through."""
        if not self._filters:
            return np.ones(len(arrived), np.bool_)
        passed = np.zeros(len(arrived), np.bool_)
        extended = arrived["flags"] & EXTENDED != 0
        for one in self._filters:
            hit = (arrived["can_id"] ^ np.uint32(one.can_id)) & np.uint32(one.mask) == 0
            passed |= hit if one.extended is None else hit & (extended == one.extended)
        return passed
