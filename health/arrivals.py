"""What comes on a skin's fabric, for programs with one thread: the newest messages of each topic, and all peers."""

import threading
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import chain

import msgspec

from canskin.fabric import Fabric, Unread
from canskin.messages import Topic
from canskin.peers import Peer


class Arrivals:
    """Subscribes to topics of a skin's fabric, and watches the peers.

    Parameters
    ----------
    fabric : Fabric
    topics : iterable of Topic
    depth : int
        Most messages of a topic that wait.

    Attributes
    ----------
    skipped : int
        Messages that newer messages of their topic replaced before they were taken.
    """

    def __init__(self, fabric: Fabric, topics: Iterable[Topic], depth: int = 1) -> None:
        self.skipped = 0
        self._fabric = fabric
        self._waiting: defaultdict[str, deque[Unread]] = defaultdict(partial(deque, maxlen=depth))
        self._arrived = threading.Condition()
        self._peers: deque[tuple[Peer, bool]] = deque()
        for topic in topics:
            fabric.subscribe_unread(topic, partial(self._put, topic.name))
        fabric.watch_peers(lambda peer, alive: self._peers.append((peer, alive)))

    @property
    def malformed(self) -> int:
        """Messages that were taken and could not be decoded."""
        return self._fabric.malformed

    def take(self, timeout_s: float) -> list[msgspec.Struct]:
        """Wait for messages, at most `timeout_s`, and return them in the order in which their topics came."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._waiting), timeout_s)
            taken = list(self._waiting.values())
            self._waiting.clear()
        return [message for unread in chain(*taken) if (message := unread()) is not None]

    def peers(self) -> Iterator[tuple[Peer, bool]]:
        """Yield the peers that came (true) or went since the last call."""
        while self._peers:
            yield self._peers.popleft()

    def _put(self, topic: str, message: Unread) -> None:
        with self._arrived:
            waiting = self._waiting[topic]
            self.skipped += len(waiting) == waiting.maxlen
            waiting.append(message)
            self._arrived.notify()
