"""Frames that wait for the bus, in the order of arbitration."""

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
    """All transmit queues of a bus as one queue in the order of arbitration, by identifier."""

    def __init__(self) -> None:
        self._ready: list[Waiting] = []
        self._future: list[tuple[int, Waiting]] = []
        self._parked: list[Waiting] = []
        #: Expired frames; the owner removes them.
        self.expired: list[Waiting] = []

    def add(self, item: Waiting, release_ns: int) -> None:
        """Add `item`; it takes part in arbitration from `release_ns`."""
        heapq.heappush(self._future, (release_ns, item))

    def park(self, item: Waiting) -> None:
        """Keep `item` out of arbitration until `unpark`."""
        self._parked.append(item)

    def unpark(self, release_ns: int) -> None:
        """Return all parked frames to arbitration from `release_ns`."""
        for item in self._parked:
            self.add(item, release_ns)
        self._parked.clear()

    def next_start_ns(self, free_ns: int) -> int | None:
        """Return the start of the next frame on a bus that is idle from `free_ns`."""
        if self._ready:
            return free_ns
        return max(free_ns, self._future[0][0]) if self._future else None

    @property
    def crowded(self) -> bool:
        """Whether released frames wait."""
        return bool(self._ready)

    def winner(self, start_ns: int) -> Waiting | None:
        """Remove and return the winner of the arbitration at `start_ns`; None if all ready frames have expired."""
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
        """Tell whether another frame with the same identifier is ready."""
        return bool(self._ready) and self._ready[0].key == item.key

    def equals(self, item: Waiting) -> list[Waiting]:
        """Remove and return other controllers' frames with the identifier of `item`: none of them loses."""
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
        """Remove and return all frames of `controller`, oldest first."""
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
