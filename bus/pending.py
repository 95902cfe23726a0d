"""Frames that wait for the wire, in the order in which they will win it."""

import heapq
from typing import NamedTuple

from bus.controller import Controller


class Waiting(NamedTuple):
    """One frame in a transmit queue; tuples compare by `key`, then by `sequence`, which is unique."""

    key: int
    sequence: int
    slot: int
    duration_ns: int
    controller: Controller
    expires_ns: int


class Pending:
    """All transmit queues of a bus, which arbitration makes one: mailboxes ordered by identifier."""

    def __init__(self) -> None:
        self._ready: list[Waiting] = []
        self._future: list[tuple[int, Waiting]] = []
        self._parked: list[Waiting] = []
        #: Frames whose time has run out, until their owner takes them from here.
        self.expired: list[Waiting] = []

    def add(self, item: Waiting, release_ns: int) -> None:
        """Let `item` take part in arbitration from `release_ns` on."""
        heapq.heappush(self._future, (release_ns, item))

    def park(self, item: Waiting) -> None:
        """Keep `item` out of arbitration until `unpark`."""
        self._parked.append(item)

    def unpark(self, release_ns: int) -> None:
        """Let all parked frames take part again."""
        for item in self._parked:
            self.add(item, release_ns)
        self._parked.clear()

    def next_start_ns(self, free_ns: int) -> int | None:
        """Return when the next frame starts on a wire that is free from `free_ns` on."""
        if self._ready:
            return free_ns
        return max(free_ns, self._future[0][0]) if self._future else None

    @property
    def crowded(self) -> bool:
        """Whether frames wait that were released."""
        return bool(self._ready)

    def winner(self, start_ns: int) -> Waiting | None:
        """Take the frame that wins the arbitration at `start_ns`; None when all that were ready had expired."""
        ready, future = self._ready, self._future
        while future and future[0][0] <= start_ns:
            heapq.heappush(ready, heapq.heappop(future)[1])
        while ready:
            item = heapq.heappop(ready)
            if not 0 < item.expires_ns < start_ns:
                return item
            self.expired.append(item)
        return None

    def contests(self, item: Waiting) -> bool:
        """Tell whether a frame with the same identifier is ready, too."""
        return bool(self._ready) and self._ready[0].key == item.key

    def equals(self, item: Waiting) -> list[Waiting]:
        """Take the frames of other controllers that cannot lose against `item`: they have its identifier."""
        equals: dict[Controller, Waiting] = {}
        kept: list[Waiting] = []
        while self.contests(item):
            other = heapq.heappop(self._ready)
            if other.controller is item.controller or other.controller in equals:
                kept.append(other)
            else:
                equals[other.controller] = other
        for other in kept:
            heapq.heappush(self._ready, other)
        return list(equals.values())

    def withdraw(self, controller: Controller) -> list[Waiting]:
        """Take all frames of `controller` back, oldest first."""
        waiting = [item for item in self._ready if item.controller is controller]
        waiting += [item for _, item in self._future if item.controller is controller]
        waiting += [item for item in self._parked if item.controller is controller]
        if waiting:
            self._ready = [item for item in self._ready if item.controller is not controller]
            self._future = [entry for entry in self._future if entry[1].controller is not controller]
            self._parked = [item for item in self._parked if item.controller is not controller]
            heapq.heapify(self._ready)
            heapq.heapify(self._future)
        return sorted(waiting, key=lambda item: item.sequence)
