"""What comes on a skin's fabric, for programs with one thread: the newest message of each topic, and all peers."""

import threading
from collections import deque
from collections.abc import Iterable, Iterator
from functools import partial

import msgspec

from canskin.fabric import Fabric
from canskin.messages import Topic
from canskin.peers import Peer


class Newest:
    """The newest message of each topic that nobody has taken; older messages are counted in `skipped`."""

    def __init__(self) -> None:
        self.skipped = 0
        self._waiting: dict[str, msgspec.Struct] = {}
        self._arrived = threading.Condition()

    def put(self, topic: str, message: msgspec.Struct) -> None:
        """Add a message in the place of an older one of its topic."""
        with self._arrived:
            self.skipped += topic in self._waiting
            self._waiting[topic] = message
            self._arrived.notify()

    def take(self, timeout_s: float) -> list[msgspec.Struct]:
        """Wait for messages, at most `timeout_s`, and return them in the order in which their topics came."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._waiting), timeout_s)
            taken, self._waiting = self._waiting, {}
        return list(taken.values())


class Arrivals:
    """Subscribes to topics, and watches the peers.

    Parameters
    ----------
    fabric : Fabric
        Of the skin.
    """

    def __init__(self, fabric: Fabric, topics: Iterable[Topic]) -> None:
        self._fabric, self._newest = fabric, Newest()
        self._peers: deque[tuple[Peer, bool]] = deque()
        for topic in topics:
            fabric.subscribe(topic, partial(self._newest.put, topic.name))
        fabric.watch_peers(lambda peer, alive: self._peers.append((peer, alive)))

    @property
    def skipped(self) -> int:
        """Messages that a newer message of their topic replaced before they were taken."""
        return self._newest.skipped

    @property
    def malformed(self) -> int:
        """Messages that could not be decoded."""
        return self._fabric.malformed

    def take(self, timeout_s: float) -> list[msgspec.Struct]:
        """Return the messages that wait; wait for them at most `timeout_s`."""
        return self._newest.take(timeout_s)

    def peers(self) -> Iterator[tuple[Peer, bool]]:
        """Yield the peers that came (true) or went since the last call."""
        while self._peers:
            yield self._peers.popleft()
