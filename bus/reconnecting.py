"""A link that reconnects: common part of the links to a virtual bus and to SocketCAN."""

import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from typing import ClassVar, Final

import numpy as np

from bus.error_frames import State
from bus.intake import new_intake
from bus.told import CAME, DESCRIPTOR, DROPPED, HAS_FAILED, NEEDS_LOOK, READER, RETURNED, STATE
from canskin.errors import BusError
from dbc.frame import FRAME, Frames, frame_bytes, frames
from dbc.frame_fields import Bytes, Integers

#: Waits for a new socket: after the loss, and the longest, to which the wait doubles with each failure in a row.
FIRST_S: Final = 0.05
LONGEST_S: Final = 0.2
#: Why a link takes no frame, of `bus.link.Link.explain`.
QUEUE_FULL: Final = "its transmit queue is full: is the bus overloaded?"


class ReconnectingLink(ABC):
    """A link with one socket; after the loss of the socket, a later call opens a new socket.

    A subclass opens sockets in `_connect`, and passes the first socket to `_use`. `send` may be called from several
    threads, `receive` from one.
    """

    #: Of `bus.told`: which compiled code reads the socket.
    _reader: ClassVar[int]

    def __init__(self) -> None:
        #: Room for what this link reads itself; what is told of it, which others may read (`tell`).
        self._own = new_intake(1)
        self._told = self._own.told[0]
        self._lock = threading.RLock()
        self._wait_s = FIRST_S
        self._next_s = 0.0
        self._socket: socket.socket | None = None
        self._dropped_before = 0
        self._is_full = False
        self._why_lost = ""
        self._epoll = select.epoll()  # one descriptor for select, the same for all sockets

    @abstractmethod
    def _connect(self) -> socket.socket:
        """Open and set up a socket."""

    @abstractmethod
    def _read(self) -> None:
        """Read the frames that wait into `_own`."""

    @abstractmethod
    def _sendable(self, burst: Frames) -> Frames:
        """Return the leading frames that may be sent, as they are sent; raise InputError for a wrong frame."""

    @abstractmethod
    def _send(self, rows: Bytes) -> int:
        """Send the leading frames for which there is room; return their number, -1 if the socket has failed."""

    def receive(self) -> Frames:
        """Return the frames that wait, own frames as echoes; never wait."""
        if self._reopened() is None:
            return frames(0)
        self._told[CAME] = self._told[NEEDS_LOOK] = 0
        self._read()
        return self.arrived(self._own.rows[0])

    def tell(self, told: Integers) -> None:
        """Use `told` for what is told of this link (`bus.told`): who reads it with others has an array for all."""
        told[:], self._told = self._told, told

    def arrived(self, rows: Bytes) -> Frames:
        """Return the frames that were read into `rows`, and use what was told besides."""
        arrived: Frames = np.ndarray(int(self._told[CAME]), FRAME, rows).copy()
        if self._told[HAS_FAILED] and self._socket is not None:
            self._lose(self._socket)
        self._reopened()
        return arrived

    def send(self, burst: Frames) -> int:
        """Put frames into the transmit queue; return the number of accepted frames, counted from the first.

        Parameters
        ----------
        burst : array of FRAME, shape (n,)
            A frame whose latest start (`expires_ns`, 0 for none) has passed is not accepted.

        Raises
        ------
        InputError
            For a frame that no controller could send.
        """
        rows, sent = frame_bytes(self._sendable(burst)), 0
        with self._lock:
            while sent < len(rows) and (connection := self._reopened()) is not None:
                count = self._send(rows[sent:])
                if count < 0:
                    self._lose(connection)
                self._is_full |= count == 0
                if count <= 0:
                    break
                sent += count
        return sent

    def fileno(self) -> int:
        """Return a file descriptor that is readable while frames wait."""
        return self._epoll.fileno()

    @property
    def state(self) -> State:
        """State of the controller; LOST without a socket."""
        return State.LOST if self._socket is None else State(min(int(self._told[STATE]), State.BUS_OFF))

    def explain(self) -> str:
        """Return what is known beyond the state."""
        was_full, self._is_full = self._is_full, False
        return self._why_lost if self._socket is None else QUEUE_FULL if was_full else ""

    @property
    def proves_echo(self) -> bool:
        """Whether an echo comes when its frame has been on the bus, at its place among the received frames."""
        return True

    @property
    def stamp_error_ns(self) -> int | None:
        """Bound of the error of the clock of the newest time stamps: 0, because a virtual bus uses CLOCK_MONOTONIC."""
        return 0

    @property
    def dropped(self) -> int:
        """Number of frames lost because `receive` was not called in time."""
        return self._dropped_before + int(self._told[DROPPED])

    def close(self) -> None:
        """Close the link."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            self._socket = None
            self._tell_new(-1)
            self._next_s = float("inf")
            self._epoll.close()

    def _use(self, connection: socket.socket) -> None:
        """Start to use a new socket."""
        self._epoll.register(connection, select.EPOLLIN)
        self._tell_new(connection.fileno())
        self._wait_s = FIRST_S
        self._socket = connection

    def _lose(self, connection: socket.socket) -> None:
        """Drop a socket that has failed, if it is still in use."""
        with self._lock:
            if connection is not self._socket:
                return
            self._epoll.unregister(connection)
            connection.close()
            self._socket = None
            self._why_lost = ""
            self._dropped_before = self.dropped
            self._tell_new(-1)
            self._fail()

    def _tell_new(self, descriptor: int) -> None:
        """Tell of a socket that nothing has come from, or of none."""
        self._told[:RETURNED] = 0
        self._told[DESCRIPTOR], self._told[READER] = descriptor, self._reader

    def _fail(self) -> None:
        """Wait before the next attempt, after each failure in a row twice as long."""
        self._next_s = time.monotonic() + self._wait_s
        self._wait_s = min(2 * self._wait_s, LONGEST_S)

    def _reopened(self) -> socket.socket | None:
        """Return the socket; after its loss, try to open a new socket."""
        if self._socket is not None or time.monotonic() < self._next_s:
            return self._socket
        with self._lock:
            if self._socket is None and time.monotonic() >= self._next_s:
                try:
                    self._use(self._connect())
                except (BusError, OSError) as error:
                    self._why_lost = getattr(error, "strerror", None) or str(error)
                    self._fail()
            return self._socket
