"""From the fabric to `ViewState`: a lock lets messages come and snapshots be taken at any time."""

import threading
import time
from abc import ABC, abstractmethod
from typing import Any

import msgspec

from canskin.fabric import Fabric
from canskin.peers import Peer
from health.backlog import Backlog
from health.snapshot import Pictures, Snapshot
from health.state import TOPICS, ViewState
from skin.layout import Layout
from views.page.history import History
from views.page.record_process import RecorderProcess
from views.page.wire import frame


class Shown(ABC):
    """What the page shows: a skin (`Feed`) or a recording (`views.page.playback.Playback`).

    Parameters
    ----------
    layout : Layout
        Of the skin shown.
    epoch_s : float
        Wall-clock time of the time 0 of its messages.
    """

    def __init__(self, layout: Layout, epoch_s: float) -> None:
        self.layout = layout
        self._epoch_s = epoch_s
        self._lock = threading.RLock()
        self._begin()

    def _begin(self) -> None:
        self._state = ViewState(self.layout, self._epoch_s)
        self._history = History(
            lambda time_s: self._state.moment(time_s - self._epoch_s),
            lambda time_s: frame(*self._snapshot(time_s - self._epoch_s, is_single=True)),
        )

    def snapshot(self) -> tuple[Snapshot, Pictures]:
        """Return the snapshot and the pictures of now."""
        with self._lock:
            return self._snapshot(self._read())

    def history(self, after_s: float) -> dict[str, list[Any]]:
        """Return the moments of the last minutes after a time, see `History.since`."""
        with self._lock:
            self._history.look(self._epoch_s + self._read())
            return self._history.since(after_s)

    def frame(self, time_s: float) -> bytes | None:
        """Return the frame nearest to a time of the last minutes; None if there is none."""
        with self._lock:
            return self._history.frame(time_s)

    def _take(self, message: msgspec.Struct, at_s: float) -> None:
        """Use a message that came at `at_s`."""
        self._history.look(self._epoch_s + at_s)
        self._state.take(message, at_s)

    @abstractmethod
    def _read(self) -> float:
        """Use all that has come; return the time of now."""

    @abstractmethod
    def _snapshot(self, now_s: float, *, is_single: bool = False) -> tuple[Snapshot, Pictures]:
        """Return the snapshot of a time."""


class Feed(Shown):
    """A running skin, whose messages the fabric's threads bring."""

    def __init__(self, layout: Layout) -> None:
        super().__init__(layout, time.time() - time.monotonic())
        self._backlog = Backlog(self._take, self._lock)
        self._fabric: Fabric | None = None
        self.recorder: RecorderProcess | None = None

    def join(self, fabric: Fabric) -> None:
        """Subscribe to all topics that the page shows."""
        self._fabric = fabric
        self._backlog.join(fabric, TOPICS)
        fabric.watch_peers(self._changed)

    def running(self, service: str) -> set[str]:
        """Return the services of this name that the skin has now, see `ViewState.running`."""
        with self._lock:
            return self._state.running(service)

    def _read(self) -> float:
        return self._backlog.read()

    def _snapshot(self, now_s: float, *, is_single: bool = False) -> tuple[Snapshot, Pictures]:
        malformed = self._fabric.malformed if self._fabric else 0
        snapshot, pictures = self._state.snapshot(now_s, malformed, is_single=is_single)
        if self.recorder is not None:
            more = self.recorder.notices + snapshot.notices
            snapshot = msgspec.structs.replace(snapshot, recorder=self.recorder.state, notices=more)
        return snapshot, pictures

    def _changed(self, peer: Peer, alive: bool) -> None:
        with self._lock:
            self._state.take_peer(peer, alive, time.monotonic())
