"""Messages of a skin's fabric, decoded together: for programs that look at a skin now and then."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Final

import msgspec

from canskin.fabric import Fabric, Unread
from canskin.messages import Topic

#: While nobody looks, messages are decoded together after this time: one by one they take several times as long.
UNREAD_S: Final = 0.5


class Backlog:
    """What the fabric's threads bring, until it is decoded.

    Parameters
    ----------
    take : callable
        Called with each message, and with the monotonic time at which it came, in seconds.
    lock : RLock
        Held while `take` is called; who calls `read` holds it, too.
    """

    def __init__(self, take: Callable[[msgspec.Struct, float], object], lock: "threading.RLock") -> None:
        self._take, self._lock = take, lock
        #: Messages that have come, and when.
        self._unread: deque[tuple[Unread, float]] = deque()

    def join(self, fabric: Fabric, topics: Iterable[Topic]) -> None:
        """Subscribe to topics."""
        for topic in topics:
            fabric.subscribe_unread(topic, self._note)

    def read(self) -> float:
        """Decode all that has come; return the time of now."""
        while self._unread:
            unread, at_s = self._unread.popleft()
            message = unread()
            if message is not None:
                self._take(message, at_s)
        return time.monotonic()

    def _note(self, unread: Unread) -> None:
        now_s = time.monotonic()
        with self._lock:
            self._unread.append((unread, now_s))
            if now_s > self._unread[0][1] + UNREAD_S:
                self.read()
