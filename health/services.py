"""The services of a skin: which are there, since when, and whether they can work with this skin."""

from typing import Final

import msgspec

from canskin.peers import Peer
from health.snapshot import Service

#: Most services kept; the service that has been gone for longest is dropped first.
SERVICES: Final = 64
#: Most tokens kept, tokens of other skins included.
PEERS: Final = 256


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

    def states(self) -> dict[str, Service]:
        """Return the state of each service, by name."""
        return {name: self._state(name) for name in sorted(self._services)}

    def other_skins(self) -> list[str]:
        """Return the names of other skins with services that know their layout."""
        return sorted({peer.skin for peer in self._peers.values() if peer.fingerprint} - {self._own.skin})

    def _state(self, name: str) -> Service:
        """Return the state of a service; of several with one name, of one that cannot work with this skin."""
        peers, service = self.peers(name), self._services[name]
        if not peers:
            return service
        peer = next((each for each in peers if self._own.difference(each)), peers[-1])
        return msgspec.structs.replace(
            service,
            version=peer.version,
            fingerprint=peer.fingerprint,
            scheduling=peer.scheduling,
            difference=self._own.difference(peer),
        )
