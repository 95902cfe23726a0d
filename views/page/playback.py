"""A recording on the page: its messages as they were recorded, by a clock that can be held, moved and hurried."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import msgspec

from canskin.errors import InputError
from canskin.messages import MARK
from health.snapshot import Pictures, PlaybackState, Snapshot
from health.state import STATUS_FRESH_S, TOPICS
from recording.mcap_file import Read, read_few, read_messages, span_ns
from shell.service import say
from skin.layout import Layout
from views.page.shown import Shown

SPEED_MIN: Final = 0.05
SPEED_MAX: Final = 20.0
#: From one look of a page to the next no more of the recording passes: it is held while no page looks, and a machine
#: that is too slow for a speed plays slower.
STEP_S: Final = 0.8


class Playback(Shown):
    """Plays a recording while a page looks. Time 0 is its first message.

    Parameters
    ----------
    clock_s : callable
        Returns the time by which the recording is played.
    """

    def __init__(self, path: Path, layout: Layout, clock_s: Callable[[], float] = time.monotonic) -> None:
        self.path = path
        self._first_ns, last_ns = span_ns(path)
        self._duration_s = (last_ns - self._first_ns) * 1e-9
        self._clock_s, self._looked_s = clock_s, clock_s()
        self._position_s, self._is_paused, self._speed = 0.0, False, 1.0
        self._said: set[str] = set()
        self._marks = [*self._readable(read_few(path, MARK))]
        super().__init__(layout, self._first_ns * 1e-9)
        self._seek(0.0)

    def play(self, position_s: float | None = None, is_paused: bool | None = None, speed: float | None = None) -> str:
        """Go to a position; hold or go on, at the end from the beginning; at a speed. Return what is done now."""
        with self._lock:
            self._read()
            if is_paused is False and position_s is None and self._position_s >= self._duration_s:
                position_s = 0.0
            self._is_paused = self._is_paused if is_paused is None else is_paused
            self._speed = self._speed if speed is None else speed
            if position_s is not None:
                self._seek(min(position_s, self._duration_s))
            how = "held" if self._is_paused else f"played at {self._speed:g} times its speed"
            return f"{how} at {self._position_s:.1f} s of {self._duration_s:.1f} s"

    def _read(self) -> float:
        now_s = self._clock_s()
        passed_s, self._looked_s = (now_s - self._looked_s) * self._speed, now_s
        if not self._is_paused:
            self._go_to(self._position_s + min(passed_s, STEP_S))
        return self._position_s

    def _seek(self, position_s: float) -> None:
        """Begin anew with the messages shortly before a position: states of nodes come five times a second.

        The newest mark before holds, however old it is.
        """
        self._begin()
        from_ns = self._first_ns + round((position_s - STATUS_FRESH_S) * 1e9)
        for mark in [each for each in self._marks if each.time_ns < from_ns][-1:]:
            self._state.take(mark.message, 0.0)
        self._messages = self._readable(read_messages(self.path, TOPICS, self._warn, from_ns))
        self._ahead = next(self._messages, None)
        self._go_to(position_s)

    def _readable(self, messages: Iterator[Read]) -> Iterator[Read]:
        """Yield messages up to one that is damaged; none if the file has gone."""
        try:
            yield from messages
        except (InputError, OSError) as error:
            self._warn(str(error))

    def _go_to(self, position_s: float) -> None:
        self._position_s = min(position_s, self._duration_s)
        while self._ahead is not None and (at_s := (self._ahead.time_ns - self._first_ns) * 1e-9) <= self._position_s:
            self._take(self._ahead.message, at_s)
            self._ahead = next(self._messages, None)
        self._is_paused |= self._position_s >= self._duration_s

    def _snapshot(self, now_s: float, *, is_single: bool = False) -> tuple[Snapshot, Pictures]:
        snapshot, pictures = self._state.snapshot(now_s, is_single=is_single)
        state = PlaybackState(
            path=str(self.path),
            position_s=now_s,
            duration_s=self._duration_s,
            is_paused=self._is_paused,
            speed=self._speed,
        )
        return msgspec.structs.replace(snapshot, playback=state), pictures

    def _warn(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            say("viewer", text)
