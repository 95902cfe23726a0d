"""What the page shows: a lock lets messages come and snapshots be taken at any time."""

import threading
import time
from abc import ABC, abstractmethod
from typing import Any

import msgspec

from canskin.fabric import Fabric
from health.feed import Feed
from health.snapshot import Pictures, Snapshot
from health.state import TOPICS, ViewState
from skin.layout import Layout
from views.page.history import History
from views.page.record_process import RecorderProcess
from views.page.wire import frame


class Shown(ABC):
    """What the page shows: a skin (`Live`) or a recording (`views.page.playback.Playback`).

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


class Live(Shown):
    """A running skin, whose messages the fabric's threads bring.

    Parameters
    ----------
    recorder : RecorderProcess, optional
        Makes recordings of the skin.
    """

    def __init__(self, layout: Layout, fabric: Fabric, recorder: RecorderProcess | None = None) -> None:
        super().__init__(layout, time.time() - time.monotonic())
        self._recorder = recorder
        self._feed = Feed(fabric, TOPICS, self._take, self._state.take_peer)
        self._lock = self._feed.lock

    def running(self, service: str) -> set[str]:
        """Return the services of this name that the skin has now, see `ViewState.running`."""
        with self._lock:
            self._read()
            return self._state.running(service)

    def _read(self) -> float:
        return self._feed.read()

    def _snapshot(self, now_s: float, *, is_single: bool = False) -> tuple[Snapshot, Pictures]:
        snapshot, pictures = self._state.snapshot(now_s, self._feed.malformed, is_single=is_single)
        if self._recorder is not None:
            more = self._recorder.notices + snapshot.notices
            snapshot = msgspec.structs.replace(snapshot, recorder=self._recorder.state, notices=more)
        return snapshot, pictures
