"""Connection of one client to the process of a bus: its waiting frames."""

import socket
from collections import deque
from typing import Final

import numpy as np

from bus.outbox import OTHERS, OWNER, Events
from bus.protocol import HEADER, MAGIC, MAX_FRAMES, Kind
from bus.station import Station
from dbc.frame import ECHO, ERROR, Frames, frames

#: Most received frames kept for a client that does not read; later frames are lost and counted.
BACKLOG_FRAMES: Final = 16384


class Batch:
    """Records that ended on the bus together; the packet for most stations is made once.

    Attributes
    ----------
    owners : set of int
        Stations that sent one of the frames, or that receive a report.
    others : array of FRAME
        The records for all other stations; `payload` holds the same records as bytes.
    """

    def __init__(self, events: Events) -> None:
        self.events = events
        self.owners = set(events.owner.tolist())
        every = events.frames
        self.others: Frames = every.copy() if events.plain else every[events.audience & OTHERS != 0]
        self.others["port"] = 0
        self.payload = self.others.tobytes()

    def of(self, station: Station) -> Frames:
        """Return the records for a station, its own frames marked as echoes; `others` itself where that is all."""
        if station.number not in self.owners:
            return frames(0) if station.off else self.others
        events = self.events
        if events.plain and len(self.owners) == 1:
            echoes: Frames = events.frames.copy()
            echoes["flags"] |= ECHO
            return echoes
        mine = events.owner == station.number
        wanted = np.where(mine, OWNER, 0 if station.off else OTHERS)
        keep = events.audience & wanted != 0
        chosen: Frames = events.frames[keep]
        own = mine[keep]
        chosen["port"] *= own
        chosen["flags"] |= np.where(own & (chosen["flags"] & ERROR == 0), np.uint8(ECHO), np.uint8(0))
        return chosen


class Backlog:
    """Frames that wait for a station.

    It is bounded: received frames by `BACKLOG_FRAMES`, later frames are dropped; echoes, which are never dropped, by
    the size of the transmit queues.

    Attributes
    ----------
    dropped : int
        Number of frames that were lost because the backlog was full.
    parts : deque of array of FRAME
        No longer than MAX_FRAMES, if those that were kept are not.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.parts: deque[Frames] = deque()

    def keep(self, part: Frames) -> None:
        """Keep frames; drop received frames above the bound."""
        if sum(map(len, self.parts)) + len(part) > BACKLOG_FRAMES:  # maybe, as echoes do not count
            waiting = sum(np.count_nonzero(each["flags"] & ECHO == 0) for each in self.parts)
            received = part["flags"] & ECHO == 0
            lost = received & (np.cumsum(received) > BACKLOG_FRAMES - waiting)
            self.dropped += int(np.count_nonzero(lost))
            part = part[~lost]
        if self.parts and len(self.parts[-1]) + len(part) <= MAX_FRAMES:
            self.parts[-1] = np.concatenate((self.parts[-1], part))
        elif len(part):
            self.parts.append(part)


class Session:
    """A station and its socket."""

    def __init__(self, connection: socket.socket, station: Station) -> None:
        self.connection = connection
        self.station = station
        self.backlog = Backlog()

    def fileno(self) -> int:
        """Return the socket's descriptor, for select."""
        return self.connection.fileno()

    @property
    def blocked(self) -> bool:
        """Whether frames wait until the client reads."""
        return bool(self.backlog.parts)

    def offer(self, batch: Batch, now_ns: int) -> None:
        """Send the client its records of a batch."""
        chosen = batch.of(self.station)
        if chosen is batch.others and len(chosen) <= MAX_FRAMES and not self.blocked:
            if len(chosen) and not self._send(len(chosen), batch.payload, now_ns):
                self.backlog.keep(chosen)
            return
        for first in range(0, len(chosen), MAX_FRAMES):
            part = chosen[first : first + MAX_FRAMES]
            if self.blocked or not self._send(len(part), part.tobytes(), now_ns):
                self.backlog.keep(part)

    def flush(self, now_ns: int) -> None:
        """Send waiting frames, as far as the client reads."""
        parts = self.backlog.parts
        while parts and self._send(len(parts[0]), parts[0].tobytes(), now_ns):
            parts.popleft()

    def _send(self, count: int, payload: bytes, now_ns: int) -> bool:
        header = HEADER.pack(MAGIC, Kind.FRAMES, self.station.state, count, self.backlog.dropped, now_ns)
        try:
            self.connection.sendmsg((header, payload))
        except BlockingIOError:
            return False
        return True
