"""A link that reconnects: common part of the links to a virtual bus and to SocketCAN."""

import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from typing import Final

from bus.error_frames import State
from canskin.errors import BusError

FIRST_S: Final = 0.05
LONGEST_S: Final = 2.0


class Backoff:
    """A wait that doubles after each failure in a row."""

    def __init__(self) -> None:
        self._wait_s = FIRST_S
        self._next_s = 0.0

    @property
    def due(self) -> bool:
        """Whether the next attempt may be made."""
        return time.monotonic() >= self._next_s

    def failed(self) -> None:
        """Double the wait before the next attempt."""
        self._next_s = time.monotonic() + self._wait_s
        self._wait_s = min(2 * self._wait_s, LONGEST_S)

    def worked(self) -> None:
        """Set the wait back to the shortest."""
        self._wait_s = FIRST_S

    def give_up(self) -> None:
        """Never try again."""
        self._next_s = float("inf")


class ReconnectingLink(ABC):
    """A link with one socket; after the loss of the socket, the next call opens a new socket when `Backoff` allows.

    A subclass opens sockets in `_connect`, passes the first socket to `_use`, and calls `_lose` when a socket fails.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._backoff = Backoff()
        self._socket: socket.socket | None = None
        self._state = State.ACTIVE
        self._dropped = self._dropped_before = 0
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

    @property
    def keeps_order(self) -> bool:
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
            self._backoff.give_up()
            self._epoll.close()

    def _use(self, connection: socket.socket) -> None:
        """Start to use a new socket."""
        self._epoll.register(connection, select.EPOLLIN)
        self._state = State.ACTIVE
        self._backoff.worked()
        self._socket = connection

    def _lose(self, connection: socket.socket) -> None:
        """Drop a socket that has failed, if it is still in use."""
        with self._lock:
            if connection is not self._socket:
                return
            self._epoll.unregister(connection)
            connection.close()
            self._socket = None
            self._dropped_before, self._dropped = self.dropped, 0  # a new socket counts from 0
            self._backoff.failed()

    def _reopened(self) -> socket.socket | None:
        """Return the socket; after its loss, try to open a new socket."""
        if self._socket is not None or not self._backoff.due:
            return self._socket
        with self._lock:
            if self._socket is None and self._backoff.due:
                try:
                    self._use(self._connect())
                except (BusError, OSError):
                    self._backoff.failed()
            return self._socket
