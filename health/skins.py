"""All skins of a hub: each is joined as soon as its layout is told."""

import time
from collections.abc import Callable
from contextlib import closing
from typing import Final, Generic, Protocol, TypeVar

from canskin.errors import SkinError
from canskin.fabric import Fabric
from canskin.peers import Peer
from canskin.session import Stop
from shell.service import say
from shell.skin_options import hub_layout, knows_layout
from skin.layout import Layout

#: Most skins; whoever may open the hub may invent names.
SKINS_MAX: Final = 16
#: Period of the search for skins.
SEARCH_S: Final = 1.0
#: A skin that could not be joined is tried again after this time.
AGAIN_S: Final = 30.0
_LOOK_S: Final = 0.05


class Closable(Protocol):
    """What was joined, and can be left."""

    def close(self) -> None:
        """Leave the skin."""


Joined = TypeVar("Joined", bound=Closable)


class Skins(Generic[Joined]):
    """Joins the skins of a hub; a skin that goes stays, with its services gone.

    Parameters
    ----------
    endpoint : str
        Of the hub.
    service : str
        Name in the log.
    join : callable
        Joins a skin, unless the stop is set meanwhile. SkinError is logged, and the skin is tried again.

    Attributes
    ----------
    joined : dict
        What `join` returned, by the name of the skin.
    """

    def __init__(self, endpoint: str, service: str, join: Callable[[Layout, Stop], Joined]) -> None:
        self._endpoint, self._service, self._join = endpoint, service, join
        self.joined: dict[str, Joined] = {}
        self._fingerprints: dict[str, str] = {}
        self._again_s: dict[str, float] = {}

    def add(self, layout: Layout, fingerprint: str, stop: Stop) -> None:
        """Join a skin; if it was joined with another layout, leave that."""
        joined, before = self._join(layout, stop), self.joined.get(layout.name)
        self.joined[layout.name], self._fingerprints[layout.name] = joined, fingerprint
        if before is not None:
            before.close()

    def run(self, stop: Stop) -> None:
        """Join each skin that comes, until `stop`."""
        with closing(Fabric("-", "", self._endpoint, stop=stop)) as lobby:
            while not stop.is_set():
                for peer in filter(knows_layout, lobby.peers()):
                    self._see(peer, stop)
                due_s = time.monotonic() + SEARCH_S
                while time.monotonic() < due_s and not stop.is_set():
                    time.sleep(_LOOK_S)

    def close(self) -> None:
        """Leave all skins."""
        for skin in self.joined.values():
            skin.close()

    def _see(self, peer: Peer, stop: Stop) -> None:
        """Join the skin of a service that tells the layout, unless this has happened with this layout."""
        name, now_s, is_known = peer.skin, time.monotonic(), peer.skin in self.joined
        if self._fingerprints.get(name) == peer.fingerprint or now_s < self._again_s.get(name, now_s):
            return
        if not is_known and len(self.joined) >= SKINS_MAX:
            return
        try:
            self.add(hub_layout(self._endpoint, name, stop, service=self._service), peer.fingerprint, stop)
        except SkinError as error:
            waiting = {skin: at_s for skin, at_s in self._again_s.items() if at_s > now_s}  # others may invent names
            self._again_s = waiting | {name: now_s + AGAIN_S}
            say(self._service, f"skin '{name}' is not shown: {error}")
        else:
            say(self._service, f"skin '{name}' {'has another layout' if is_known else 'is shown'}")
