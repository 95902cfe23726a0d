"""The services of a skin: which are there, since when, and whether they can work with this skin."""

from collections import Counter
from collections.abc import Iterable
from typing import Final, TypeVar

import msgspec

from canskin.messages import UNKNOWN_ERROR_NS, ServiceStatus
from canskin.peers import Peer
from health.snapshot import Service

#: Most services kept; the service that has been gone for longest is dropped first.
SERVICES: Final = 64
#: Counters of a process (`canskin.messages.ServiceStatus`) whose sums are those of its service.
COUNTERS: Final = ("processor_s", "missed", "overruns")
#: Most tokens kept, tokens of other skins included, and most services whose own figures are kept.
PEERS: Final = 256
#: What services tell of themselves once a second is of no use after this time.
TOLD_S: Final = 3.0
#: A service loses messages until none has been lost for this time.
LOSS_S: Final = 3.0

Number = TypeVar("Number", int, float)


class Told:
    """What one service tells of itself, once a second."""

    def __init__(self, status: ServiceStatus, now_s: float) -> None:
        self.status, self.at_s = status, now_s
        self.processor_ratio: float | None = None
        self.made_per_s: float | None = None
        self._loss_s: tuple[float, float] | None = None

    @property
    def lost(self) -> int:
        """Number of messages since the start of its process."""
        return self.status.missed + self.status.overruns

    def take(self, status: ServiceStatus, now_s: float) -> None:
        """Take what comes next."""
        before, lost = self.status, self.lost
        self.status, self.at_s = status, now_s
        span_s = (status.time_ns - before.time_ns) * 1e-9
        if span_s > 0:  # else its wall clock was set back
            self.processor_ratio = max(0.0, status.processor_s - before.processor_s) / span_s
            self.made_per_s = max(0, status.made - before.made) / span_s
        if self.lost > lost:
            since_s = self.loses_since_s(now_s)
            self._loss_s = now_s if since_s is None else since_s, now_s

    def loses_since_s(self, now_s: float) -> float | None:
        """Return since when it loses messages; None if it does not."""
        return self._loss_s[0] if self._loss_s and now_s - self._loss_s[1] < LOSS_S else None


class Services:
    """Services by name: one is there while at least one peer of its name is.

    Parameters
    ----------
    own : Peer
        What the others are compared with.
    epoch_s : float
        Wall-clock time of ``now_s = 0``.
    """

    def __init__(self, own: Peer, epoch_s: float) -> None:
        self._own, self._epoch_s = own, epoch_s
        self._peers: dict[str, Peer] = {}
        self._services: dict[str, Service] = {}
        self._told: dict[str, Told] = {}
        self._sums: dict[str, Counter[str]] = {}

    def take_status(self, status: ServiceStatus, now_s: float) -> None:
        """Note what a service told of itself at `now_s`."""
        told = self._told.pop(status.instance, None)
        if status.service in self._sums or len(self._sums) < SERVICES:
            sums = self._sums.setdefault(status.service, Counter())
            for name in COUNTERS:  # a sum never goes back
                sums[name] += max(0, getattr(status, name) - (getattr(told.status, name) if told else 0))
        told = told or Told(status, now_s)
        told.take(status, now_s)
        self._told[status.instance] = told
        if len(self._told) > PEERS:
            del self._told[next(iter(self._told))]

    def take(self, peer: Peer, alive: bool, now_s: float) -> None:
        """Note that a peer of any skin came or went at `now_s`."""
        if not alive:
            self._peers.pop(peer.key, None)
        elif len(self._peers) < PEERS:
            self._peers[peer.key] = peer
        name, is_there = peer.service, bool(self.peers(peer.service))
        known = self._services.get(name)
        if peer.skin != self._own.skin or (known is not None and known.alive == is_there):
            return
        if known is None and len(self._services) >= SERVICES:
            gone = [each for each, service in self._services.items() if not service.alive]
            if not gone:
                return
            del self._services[min(gone, key=lambda each: self._services[each].since_time_s)]
        self._services[name] = Service(alive=is_there, since_time_s=self._epoch_s + now_s)

    def peers(self, name: str) -> list[Peer]:
        """Return the peers of this skin that have a name."""
        return [each for each in self._peers.values() if (each.skin, each.service) == (self._own.skin, name)]

    def since_s(self, name: str, *, alive: bool) -> float | None:
        """Return since when a service is there, or gone; None if it is not, or unknown."""
        known = self._services.get(name)
        return known.since_time_s - self._epoch_s if known is not None and known.alive == alive else None

    def states(self, now_s: float) -> dict[str, Service]:
        """Return the state of each service at `now_s`, by name."""
        return {name: self._state(name, now_s) for name in sorted(self._services)}

    def other_skins(self) -> list[str]:
        """Return the names of other skins with services that know their layout."""
        return sorted({peer.skin for peer in self._peers.values() if peer.fingerprint} - {self._own.skin})

    def _state(self, name: str, now_s: float) -> Service:
        """Return the state of a service; of several with one name, of one that cannot work with this skin."""
        peers, sums = self.peers(name), self._sums.get(name, Counter())
        service = msgspec.structs.replace(self._services[name], **sums)
        if not peers:
            return service
        peer = next((each for each in peers if self._own.difference(each)), peers[-1])
        told = [self._told[each.instance] for each in peers if each.instance in self._told]
        told = [each for each in told if now_s - each.at_s < TOLD_S]
        loses_since_s = [since_s for each in told if (since_s := each.loses_since_s(now_s)) is not None]
        clocks = [(each.status.clock_error_ns, each.status.clock_offset_ns) for each in told]
        error_ns, offset_ns = max(clocks, default=(UNKNOWN_ERROR_NS, 0))
        is_told = error_ns != UNKNOWN_ERROR_NS
        return msgspec.structs.replace(
            service,
            version=peer.version,
            fingerprint=peer.fingerprint,
            scheduling=peer.scheduling,
            difference=self._own.difference(peer),
            memory_bytes=_sum(each.status.memory_bytes or None for each in told),
            processor_ratio=_sum(each.processor_ratio for each in told),
            made_per_s=_sum(each.made_per_s for each in told),
            loses_since_time_s=self._epoch_s + min(loses_since_s) if loses_since_s else None,
            clock_offset_s=offset_ns * 1e-9 if is_told else None,
            clock_error_s=error_ns * 1e-9 if is_told else None,
        )


def _sum(values: Iterable[Number | None]) -> Number | None:
    known = [each for each in values if each is not None]
    return sum(known) if known else None
