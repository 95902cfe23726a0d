"""A link that reconnects: common part of the links to a virtual bus and to SocketCAN."""

import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from typing import Final

from bus.error_frames import State
from canskin.errors import BusError

#: Waits for a new socket: after the loss, and the longest, to which the wait doubles with each failure in a row.
FIRST_S: Final = 0.05
LONGEST_S: Final = 0.2
#: Why a link takes no frame, of `bus.link.Link.explain`.
QUEUE_FULL: Final = "its transmit queue is full: is the bus overloaded?"


class ReconnectingLink(ABC):
    """A link with one socket; after the loss of the socket, a later call opens a new socket.

    A subclass opens sockets in `_connect`, passes the first socket to `_use`, and calls `_lose` when a socket fails.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._wait_s = FIRST_S
        self._next_s = 0.0
        self._socket: socket.socket | None = None
        self._state = State.ACTIVE
        self._dropped = self._dropped_before = 0
        self._is_full = False
        self._why_lost = ""
        self._epoll = select.epoll()  # one descriptor for select, the same for all sockets

    @abstractmethod
    def _connect(self) -> socket.socket:
        """Open and set up a socket."""

    def fileno(self) -> int:
        """Return a file descriptor that is readable while frames wait."""
        return self._epoll.fileno()

    @property
    def state(self) -> State:
        """State of the controller; LOST without a socket."""
        return State.LOST if self._socket is None else self._state

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
        return self._dropped_before + self._dropped

    def close(self) -> None:
        """Close the link."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            self._socket = None
            self._next_s = float("inf")
            self._epoll.close()

    def _use(self, connection: socket.socket) -> None:
        """Start to use a new socket."""
        self._epoll.register(connection, select.EPOLLIN)
        self._state = State.ACTIVE
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
            self._dropped_before, self._dropped = self.dropped, 0  # a new socket counts from 0
            self._fail()

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
