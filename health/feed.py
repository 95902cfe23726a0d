"""What comes on a skin's fabric, for everybody who shows the skin."""

import threading
import time
from collections.abc import Callable, Hashable, Iterable
from functools import partial
from typing import Final

import msgspec

from canskin.fabric import Fabric, Unread
from canskin.messages import Topic
from canskin.peers import Peer
from health.snapshot import Snapshot
from health.state import TOPICS, ViewState
from skin.layout import Layout

#: While nobody reads, messages are decoded together after this time: one by one they take several times as long.
UNREAD_S: Final = 0.5
#: Most messages of a topic that wait for who polls: at the highest SYNC rate those of a quarter of a second.
POLLED: Final = 512


class Feed:
    """Gives messages, and the peers that come or go, to who shows them: in the order in which they came.

    Parameters
    ----------
    fabric : Fabric
    topics : iterable of Topic
    take, take_peer : callable
        Called with each message, or with a peer and whether it is there, and with the time at which it came, seconds;
        `lock` is held.
    newest : bool
        Of each topic the newest message alone waits, and `read` alone decodes. Otherwise no message is left out: while
        nobody reads, a thread of the fabric does.
    polled : bool
        For one thread that reads ten times a second: no thread wakes for a message, which costs more than the message.
        Messages are given topic by topic, with the time of the read.
    clock_s : callable
        Monotonic clock.

    Attributes
    ----------
    lock : RLock
        Whoever shows what was taken holds it.
    """

    def __init__(
        self,
        fabric: Fabric,
        topics: Iterable[Topic],
        take: Callable[[msgspec.Struct, float], object],
        take_peer: Callable[[Peer, bool, float], object],
        *,
        newest: bool = False,
        polled: bool = False,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.lock = threading.RLock()
        self._fabric, self._take, self._newest, self._clock_s = fabric, take, newest, clock_s
        #: Set by messages: nobody waits for peers.
        self._arrived, self._put_lock = threading.Event(), threading.Lock()
        #: What has come, and when; of the newest messages by topic.
        self._waiting: dict[Hashable, tuple[Callable[[float], object], float]] = {}
        self._mailboxes = [fabric.mailbox(topic, POLLED) for topic in topics] if polled else []
        for topic in () if polled else topics:
            fabric.subscribe_unread(topic, partial(self._put_message, topic.name))
        fabric.watch_peers(lambda peer, alive: self._put("", partial(take_peer, peer, alive)))

    @property
    def malformed(self) -> int:
        """Messages that were read and could not be decoded."""
        return self._fabric.malformed

    def read(self, timeout_s: float = 0.0) -> float:
        """Give all that has come, after a wait of at most `timeout_s` for a message; return the time of now."""
        self._arrived.wait(timeout_s)
        with self.lock:
            with self._put_lock:
                self._arrived.clear()
                waiting, self._waiting = self._waiting, {}
            for use, at_s in waiting.values():
                use(at_s)
            now_s = self._clock_s()
            for mailbox in self._mailboxes:
                while (message := mailbox.get(0.0)) is not None:
                    self._take(message, now_s)
        return now_s

    def _put_message(self, topic: str, unread: Unread) -> None:
        self._put(topic, partial(self._decode, unread))

    def _decode(self, unread: Unread, at_s: float) -> None:
        message = unread()
        if message is not None:
            self._take(message, at_s)

    def _put(self, topic: str, use: Callable[[float], object]) -> None:
        key = topic if topic and self._newest else object()
        with self._put_lock:
            now_s = self._clock_s()
            self._waiting.pop(key, None)
            self._waiting[key] = use, now_s
            if topic:
                self._arrived.set()
            _, oldest_s = next(iter(self._waiting.values()))
        if now_s > oldest_s + UNREAD_S and not self._newest:
            self.read()


class Watched:
    """The state of a running skin, from now on; `Feed` has the parameters.

    Raises
    ------
    DeniedError
        If the keys may not hear all that says how the skin is.
    """

    def __init__(
        self, layout: Layout, fabric: Fabric, topics: Iterable[Topic] = TOPICS, *, polled: bool = False
    ) -> None:
        self._begun_time_s = time.time()
        self._state = ViewState(layout, self._begun_time_s - time.monotonic(), fabric.service or "command")
        self._feed = Feed(fabric, topics, self._state.take, self._state.take_peer, polled=polled)

    def snapshot(self) -> Snapshot:
        """Return the skin as it is now."""
        with self._feed.lock:
            return self._state.snapshot(self._feed.read(), self._feed.malformed)[0]

    def look(self) -> Snapshot:
        """Return the same with the times since when that are before the look: the others say nothing."""
        snapshot, notices = self.snapshot(), []
        for each in snapshot.notices:
            is_old = each.since_time_s is not None and each.since_time_s < self._begun_time_s
            notices.append(each if is_old else msgspec.structs.replace(each, since_time_s=None))
        return msgspec.structs.replace(snapshot, notices=notices)
