"""What comes on a skin's fabric, for programs with one thread: the newest message of each topic, and all peers."""

from collections import deque
from collections.abc import Iterable, Iterator
from functools import partial

import msgspec

from canskin.fabric import Fabric
from canskin.messages import Topic
from canskin.peers import Peer
from skin.newest import Newest


class Arrivals:
    """Subscribes to topics, and watches the peers.

    Parameters
    ----------
    fabric : Fabric
        Of the skin.
    topics : iterable of Topic
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
