"""From the fabric to `ViewState`: a lock lets messages come and snapshots be taken at any time."""

import threading
import time
from collections import deque
from typing import Final

from canskin.fabric import Fabric, Unread
from canskin.peers import Peer
from health.snapshot import Pictures, Snapshot
from health.state import TOPICS, ViewState
from skin.layout import Layout

#: While nobody looks, messages are decoded together after this time: one by one they take several times as long.
UNREAD_S: Final = 0.5


class Feed:
    """A `ViewState` that the fabric's threads fill and the page's server reads.

    Parameters
    ----------
    layout : Layout
        Of the skin shown.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._state = ViewState(layout, time.time() - time.monotonic())
        self._lock = threading.Lock()
        #: Messages that have come, and when.
        self._unread: deque[tuple[Unread, float]] = deque()
        self._fabric: Fabric | None = None

    def join(self, fabric: Fabric) -> None:
        """Subscribe to all topics that the page shows."""
        self._fabric = fabric
        for topic in TOPICS:
            fabric.subscribe_unread(topic, self._note)
        fabric.watch_peers(self._changed)

    def snapshot(self) -> tuple[Snapshot, Pictures]:
        """Return the snapshot and the pictures of now."""
        with self._lock:
            self._read()
            return self._state.snapshot(time.monotonic(), self._fabric.malformed if self._fabric else 0)

    def _note(self, unread: Unread) -> None:
        now_s = time.monotonic()
        with self._lock:
            self._unread.append((unread, now_s))
            if now_s > self._unread[0][1] + UNREAD_S:
                self._read()

    def _read(self) -> None:
        """Use all messages that have come."""
        while self._unread:
            unread, at_s = self._unread.popleft()
            message = unread()
            if message is not None:
                self._state.take(message, at_s)

    def _changed(self, peer: Peer, alive: bool) -> None:
        with self._lock:
            self._state.take_peer(peer, alive, time.monotonic())
