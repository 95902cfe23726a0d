"""A socket that comes back by itself: what the links to a virtual bus and to SocketCAN have in common."""

import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from typing import Final

from bus.error_frames import State
from skin.errors import BusError

FIRST_S: Final = 0.05
LONGEST_S: Final = 2.0


class Backoff:
    """Doubles the wait after each failure in a row."""

    def __init__(self) -> None:
        self._wait_s = FIRST_S
        self._next_s = 0.0

    @property
    def due(self) -> bool:
        """Whether the next attempt may be made."""
        return time.monotonic() >= self._next_s

    def failed(self) -> None:
        """Wait before the next attempt, twice as long as the last time."""
        self._next_s = time.monotonic() + self._wait_s
        self._wait_s = min(2 * self._wait_s, LONGEST_S)

    def worked(self) -> None:
        """Begin anew with short waits."""
        self._wait_s = FIRST_S

    def give_up(self) -> None:
        """Never try again."""
        self._next_s = float("inf")


class ReconnectingLink(ABC):
    """A link on one socket; when the socket is lost, the next call opens it again, but not too often.

    A subclass opens sockets in `_connect`, takes the first one with `_use`, and calls `_lose` when a socket fails.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._backoff = Backoff()
        self._socket: socket.socket | None = None
        self._state = State.ACTIVE
        self._dropped = self._dropped_before = 0
        self._epoll = select.epoll()  # one descriptor for select, whatever happens to the socket

    @abstractmethod
    def _connect(self) -> socket.socket:
        """Open a socket, and set up what goes with it.

        Raises
        ------
        OSError, BusError
            If that fails.
        """

    def fileno(self) -> int:
        """Return a descriptor that is readable when frames wait."""
        return self._epoll.fileno()

    @property
    def state(self) -> State:
        """What the controller says of itself; LOST while there is no socket."""
        return State.LOST if self._socket is None else self._state

    @property
    def dropped(self) -> int:
        """Frames that were lost because `receive` was not called in time."""
        return self._dropped_before + self._dropped

    def close(self) -> None:
        """Close the socket for good."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            self._socket = None
            self._backoff.give_up()
            self._epoll.close()

    def _use(self, connection: socket.socket) -> None:
        """Take a new socket into use."""
        self._epoll.register(connection, select.EPOLLIN)
        self._state = State.ACTIVE
        self._backoff.worked()
        self._socket = connection

    def _lose(self, connection: socket.socket) -> None:
        """Let go of a socket that has failed, unless that has been done."""
        with self._lock:
            if connection is not self._socket:
                return
            self._epoll.unregister(connection)
            connection.close()
            self._socket = None
            self._dropped_before, self._dropped = self.dropped, 0  # a new socket counts from 0
            self._backoff.failed()

    def _reopened(self) -> socket.socket | None:
        """Return the socket; when it is lost, try to open a new one."""
        if self._socket is not None or not self._backoff.due:
            return self._socket
        with self._lock:
            if self._socket is None and self._backoff.due:
                try:
                    self._use(self._connect())
                except (BusError, OSError):
                    self._backoff.failed()
            return self._socket
