"""A skin, as a program sees it: frames, tare, health."""

import asyncio
import contextlib
import math
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Final

import msgspec

from canskin.calibration_messages import Region
from canskin.description import Description
from canskin.errors import BusError
from canskin.frame import Frame
from canskin.messages import GatewayStatus, check_label

#: Of what is asked for after `close`.
CLOSED: Final = "the connection to the skin is closed: connect again"


class Health(msgspec.Struct, frozen=True, kw_only=True):
    """How a skin and the connection to it are.

    Attributes
    ----------
    services : frozenset of str
        Services that are present: gateway, reconstructor, classifier, nodes ...
    gateway : GatewayStatus or None
        The gateway's newest counters: lost frames, nodes, buses, calibration. None if none came yet.
    frames : int
        Frames since the connection was made.
    refused : int
        Messages that could not be used: of another version, or another layout.
    missed : dict of str to int
        Messages that did not come, by topic: this program, or its connection, was too slow.
    """

    services: frozenset[str]
    gateway: GatewayStatus | None
    frames: int
    refused: int
    missed: dict[str, int] = {}


class Frames:
    """The frames of a skin from now on, for ``for`` and ``async for``: a queue of limited length.

    A reader that is slower than the skin loses the oldest frames; `lost` counts them. The iteration ends when the skin
    is closed.

    Parameters
    ----------
    depth : int
        Length of the queue; 1: only the newest frame.
    timeout_s : float
        Longest wait for a frame.
    explain : callable
        Tells why no frame comes.
    """

    def __init__(self, depth: int, timeout_s: float, explain: Callable[[], str]) -> None:
        self.lost = 0
        self._waiting: deque[Frame] = deque(maxlen=depth)
        self._changed = threading.Condition()
        self._listeners: set[Callable[[], None]] = set()
        self._timeout_s = timeout_s
        self._explain = explain
        self._is_closed = False

    def put(self, frame: Frame) -> None:
        """Add a frame; when the queue is full, its oldest frame is lost."""
        with self._changed:
            if self._is_closed:
                return
            self.lost += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(frame)
            self._wake()

    def close(self) -> None:
        """End the iteration; frames in the queue can still be read."""
        with self._changed:
            self._is_closed = True
            self._wake()

    def __iter__(self) -> "Frames":
        return self

    def __next__(self) -> Frame:
        with self._changed:
            if not self._changed.wait_for(self._has_news, self._timeout_s):
                raise BusError(self._explain())
            if not self._waiting:
                raise StopIteration
            return self._waiting.popleft()

    def __aiter__(self) -> "Frames":
        return self

    async def __anext__(self) -> Frame:
        give_up_s = time.monotonic() + self._timeout_s
        while True:
            with self._changed:
                if self._waiting:
                    return self._waiting.popleft()
                if self._is_closed:
                    raise StopAsyncIteration
            await self._arrival(give_up_s - time.monotonic())  # of a frame that another task may take

    async def _arrival(self, timeout_s: float) -> None:
        """Wait for a frame or the end."""
        arrived, loop = asyncio.Event(), asyncio.get_running_loop()

        def wake() -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(arrived.set)

        with self._changed:
            self._listeners.add(wake)
            if self._has_news():
                arrived.set()
        try:
            await asyncio.wait_for(arrived.wait(), timeout_s)
        except asyncio.TimeoutError:
            raise BusError(self._explain()) from None
        finally:
            with self._changed:
                self._listeners.discard(wake)

    def _has_news(self) -> bool:
        return bool(self._waiting) or self._is_closed

    def _wake(self) -> None:
        self._changed.notify_all()
        for listener in self._listeners:
            listener()


class Skin(ABC):
    """A skin: connected (`canskin.connect`) or simulated (`canskin.simulate`).

    ``with`` closes it. ``for frame in skin`` and ``async for frame in skin`` give the newest frame each time; for every
    frame use `frames`.

    Attributes
    ----------
    layout : Description
        Geometry of the skin.
    """

    def __init__(self, layout: Description, timeout_s: float) -> None:
        self.layout = layout
        self._timeout_s = timeout_s

    @abstractmethod
    def frames(self, queue: int = 1) -> Frames:
        """Return the frames from now on: all, while at most `queue` wait to be read.

        Raises
        ------
        BusError
            In the iteration, if no frame comes in time; the message says what is missing.
        """

    @abstractmethod
    def latest(self, max_age_s: float = 1.0) -> Frame:
        """Return the newest frame; wait for one if it is older than `max_age_s`.

        Raises
        ------
        BusError
            If no frame comes in time; the message says what is missing.
        """

    @abstractmethod
    def tare(self, *, force: bool = False, region: Region | str | None = None) -> str:
        """Measure the zero of the skin anew; return the gateway's report. Nothing may touch the skin for 2 s.

        With `force`, whatever touches the skin becomes part of its zero. With `region` (first row, first column, last
        row, last column, or the name of a region of the layout), whatever stands there now does, and the rest of the
        skin keeps its zero.

        Raises
        ------
        InputError
            If the region is not on the skin, or is named together with `force`.
        RunError
            If there is no new zero, because something touches the skin or moves on it.
        BusError
            If no gateway answers.
        """

    def mark(self, label: str) -> None:
        """Say what touches the skin from now on, for the recordings that are being made; ``""`` ends it.

        Labels of recordings train a classifier (``skin train --recordings``). A simulated skin is not recorded.

        Raises
        ------
        InputError
            If the label is longer than `canskin.messages.LONGEST_LABEL`, or not printable.
        BusError
            If no recorder is there.
        """
        check_label(label)

    @property
    @abstractmethod
    def health(self) -> Health:
        """How the skin and the connection are now."""

    @abstractmethod
    def close(self) -> None:
        """End all iterations and the connection."""

    def __iter__(self) -> Frames:
        return self.frames()

    def __aiter__(self) -> Frames:
        return self.frames()

    def __enter__(self) -> "Skin":  # noqa: PYI034 - Python 3.10 has no Self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class FrameHub:
    """Hands every frame to all readers.

    Parameters
    ----------
    timeout_s : float
        Longest wait of a reader for a frame.
    explain : callable
        Tells why no frame comes.
    """

    def __init__(self, timeout_s: float, explain: Callable[[], str]) -> None:
        self.count = 0
        self._newest: Frame | None = None
        self._changed = threading.Condition()
        self._readers: weakref.WeakSet[Frames] = weakref.WeakSet()
        self._timeout_s = timeout_s
        self._explain = explain
        self.is_closed = False

    def put(self, frame: Frame) -> None:
        """Hand on a frame."""
        with self._changed:
            self.count += 1
            self._newest = frame
            self._changed.notify_all()
            readers = list(self._readers)
        for reader in readers:
            reader.put(frame)

    def frames(self, queue: int) -> Frames:
        """Return a new reader."""
        reader = Frames(max(1, queue), self._timeout_s, self._explain)
        with self._changed:
            if self.is_closed:
                reader.close()
            self._readers.add(reader)
        return reader

    def latest(self, max_age_s: float) -> Frame:
        """Return the newest frame, or the next if it is too old.

        Raises
        ------
        BusError
            If none came in time, or the connection is closed.
        """
        give_up_s = time.monotonic() + self._timeout_s
        with self._changed:
            first = self._newest
            while True:
                if self.is_closed:
                    raise BusError(CLOSED)
                newest = self._newest
                if newest is not None and (max_age_s == math.inf or newest.age <= max_age_s):  # no age: too old
                    return newest
                left_s = give_up_s - time.monotonic()
                if left_s > 0:
                    self._changed.wait(left_s)
                elif newest is None or newest is first:
                    raise BusError(self._explain())
                else:
                    raise BusError(f"the newest image is {newest.age:.3g} s old, asked for {max_age_s:g} s at most")

    def close(self) -> None:
        """End all readers."""
        with self._changed:
            self.is_closed = True
            self._changed.notify_all()
            readers = list(self._readers)
        for reader in readers:
            reader.close()
