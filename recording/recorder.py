"""The recorder of a skin: reads buses and fabric, and writes to a sink. It sends nothing on the buses."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from bus.link import Link, State
from canskin.fabric import Missed, Origin
from canskin.messages import MARK, Topic
from recording.mcap_file import EVENTS, LONGEST_MESSAGE, RECORDER, File
from recording.sinks import Sink
from shell.pulse import Beat, unheard
from shell.service import StopSignal, say

#: Time between two batches of frames that are read. Links keep some thousands of frames.
TURN_S: Final = 0.05
#: All that is older than this, and one turn, is in the file after a crash.
FLUSH_S: Final = 0.5
#: Most messages that wait for a turn; the newest are lost and counted above it.
MOST_WAITING: Final = 20_000
#: Most batches of one bus in a turn.
_BATCHES: Final = 64


class _Waiting(NamedTuple):
    time_ns: int
    topic: Topic | None
    content: bytes | Mapping[str, Any]


class Recorder:
    """Writes what buses and fabric carry.

    Parameters
    ----------
    links : mapping of int to Link
        By number of the bus.
    names : mapping of int to str
        Of the buses, for the log.
    wall_ns, mono_ns : callable
        The clocks.
    beat : callable
        Called in each turn with what was written so far.

    Attributes
    ----------
    frames, messages : int
        Written so far; marks do not count.
    left_out : int
        Frames that the format of the file does not hold.
    missed : Missed
        Messages that did not come.
    """

    def __init__(
        self,
        links: Mapping[int, Link],
        sink: Sink,
        names: Mapping[int, str],
        *,
        wall_ns: Callable[[], int] = time.time_ns,
        mono_ns: Callable[[], int] = time.monotonic_ns,
        beat: Beat = unheard,
    ) -> None:
        self.frames = self.messages = self.left_out = 0
        self.missed = Missed()
        self._links, self.sink, self._names = dict(links), sink, names
        self._wall_ns, self._mono_ns, self._beat = wall_ns, mono_ns, beat
        self._waiting: deque[_Waiting] = deque()
        self._files: deque[File] = deque()
        self._lost_messages = 0
        self._is_lost = dict.fromkeys(links, False)
        self._flush_ns = mono_ns()

    @property
    def lost(self) -> int:
        """Frames and messages that came and were not recorded."""
        return self._lost_messages + sum(link.dropped for link in self._links.values())

    def take_message(self, topic: Topic, content: bytes, origin: Origin | None = None) -> None:
        """Take a message of the fabric; from any thread."""
        if origin is not None:
            self.missed.take(topic.name, origin)
        if len(content) > LONGEST_MESSAGE:  # of another program: no reader would take its chunk
            self._lost_messages += 1
            return
        self._wait(_Waiting(self._wall_ns(), topic, content))

    def take_event(self, source: str, text: str) -> None:
        """Take note of an event; from any thread."""
        self._wait(_Waiting(self._wall_ns(), None, {"source": source, "text": text}))

    def take_file(self, file: File) -> None:
        """Take an attachment; from any thread."""
        self._files.append(file)

    def turn(self) -> None:
        """Write what has come since the last turn; make it readable when it is time.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        now_ns = self._wall_ns()
        offset_ns = now_ns - self._mono_ns()
        for number, link in self._links.items():
            for _ in range(_BATCHES):
                arrived = link.receive()
                if not len(arrived):
                    break
                held = self.sink.frames(number, arrived, now_ns, offset_ns)
                self.frames += held
                self.left_out += len(arrived) - held
            self._look(number, link)
        for _ in range(len(self._waiting)):
            time_ns, topic, content = self._waiting.popleft()
            if topic is not None and isinstance(content, bytes):
                self.messages += topic is not MARK
                self.sink.message(topic, time_ns, content)
            elif not isinstance(content, bytes):
                self.sink.note(EVENTS, time_ns, content)
        while self._files:
            self.sink.attach(self._files.popleft(), now_ns)
        if self._mono_ns() - self._flush_ns >= FLUSH_S * 1e9:
            self._flush_ns = self._mono_ns()
            self.tell_counters()
            self.sink.flush()
        self._beat(self.frames + self.messages)

    def _wait(self, one: _Waiting) -> None:
        if not self.sink.has_messages:
            return
        if len(self._waiting) >= MOST_WAITING:
            self._lost_messages += 1
            return
        self._waiting.append(one)

    def _look(self, number: int, link: Link) -> None:
        """Log when a bus is lost, and when it is back."""
        is_lost = link.state is State.LOST
        if is_lost != self._is_lost[number]:
            self._is_lost[number] = is_lost
            text = f"{self._names[number]} is {'lost' if is_lost else 'back'}"
            say("record", text)
            self.take_event("record", text)

    def tell_counters(self) -> None:
        """Write the counters.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        now_ns = self._wall_ns()
        values = {
            "frames": self.frames,
            "messages": self.messages,
            "lost_messages": self._lost_messages,
            "missed_messages": self.missed.counts(),
            "lost_frames": {self._names[number]: link.dropped for number, link in self._links.items()},
            "wall_offset_ns": now_ns - self._mono_ns(),
        }
        self.sink.note(RECORDER, now_ns, values)


def run(recorders: Sequence[Recorder], stop: StopSignal, until_s: float = math.inf) -> None:
    """Record until `stop`, or for `until_s` seconds; of many skins, all into one file.

    Raises
    ------
    OSError
        If the file cannot be written; what was written before is readable.
    """
    end_s = time.monotonic() + until_s
    try:
        while not stop.is_set() and time.monotonic() < end_s:
            time.sleep(TURN_S)
            for each in recorders:
                each.turn()
        for each in recorders:
            each.turn()
            each.tell_counters()
        for each in recorders:
            each.sink.close()
    except OSError:
        for each in recorders:
            each.sink.abandon()
        raise
