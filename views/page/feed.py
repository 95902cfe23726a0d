"""From the fabric to `ViewState`: a lock lets messages come and snapshots be taken at any time."""

import threading
import time

import msgspec

from canskin.fabric import Fabric
from canskin.peers import Peer
from health.snapshot import Pictures, Snapshot
from health.state import TOPICS, ViewState
from skin.layout import Layout


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
        self._fabric: Fabric | None = None

    def join(self, fabric: Fabric) -> None:
        """Subscribe to all topics that the page shows."""
        self._fabric = fabric
        for topic in TOPICS:
            fabric.subscribe(topic, self._note)
        fabric.watch_peers(self._changed)

    def snapshot(self) -> tuple[Snapshot, Pictures]:
        """Return the snapshot and the pictures of now."""
        undecodable = self._fabric.malformed if self._fabric else 0
        with self._lock:
            return self._state.snapshot(time.monotonic(), undecodable)

    def _note(self, message: msgspec.Struct) -> None:
        with self._lock:
            self._state.take(message, time.monotonic())

    def _changed(self, peer: Peer, alive: bool) -> None:
        with self._lock:
            self._state.take_peer(peer, alive, time.monotonic())
