"""The services on the fabric: their liveliness tokens, and whether two services can work together."""

import re
import secrets
from importlib.metadata import version
from typing import Final

import msgspec

#: Random bytes that distinguish services of one name.
INSTANCE_BYTES: Final = 4
#: Separator in the last part of a token; neither versions (PEP 440) nor fingerprints contain it.
SEPARATOR: Final = "-"
#: Between an instance and its scheduling: other versions take both for the instance.
SCHEDULING: Final = "~"
#: Values of `Peer.scheduling`.
REAL_TIME: Final = "realtime"
ORDINARY: Final = "ordinary"
#: Services that tell a skin's layout and geometry; a skin has one of them.
GATEWAYS: Final = ("gateway", "replay")
#: Services whose layout and version matter to others. Whoever may only read can pass for no service of these.
MAKERS: Final = (*GATEWAYS, "nodes", "reconstructor", "classifier")


class Peer(msgspec.Struct, frozen=True):
    """A service on the fabric.

    Attributes
    ----------
    skin : str
        Name of the service's layout.
    service : str
    instance : str
        Distinguishes services of one name, for example two pages.
    version : str
        Version of canskin; empty if unknown.
    fingerprint : str
        Fingerprint of its Φ (`skin.phi.Sbhe.fingerprint`); empty for a service without Φ.
    scheduling : str
        `REAL_TIME` or `ORDINARY`; empty until the service has asked for real time.
    """

    skin: str
    service: str
    instance: str
    version: str = ""
    fingerprint: str = ""
    scheduling: str = ""

    @property
    def key(self) -> str:
        """The key of the liveliness token, ``canskin/SKIN/alive/SERVICE/INSTANCE~SCHEDULING-VERSION-FINGERPRINT``."""
        instance = self.instance + (SCHEDULING + self.scheduling if self.scheduling else "")
        about = SEPARATOR.join((instance, self.version, self.fingerprint))
        return f"canskin/{self.skin}/alive/{self.service}/{about}"

    def difference(self, other: "Peer") -> str:
        """Return why this service cannot work with `other`, which is of the same skin.

        Empty if it can, or `other` only reads, or is not known.
        """
        if other.service not in MAKERS or not self.fingerprint or not other.fingerprint:
            return ""
        if other.fingerprint != self.fingerprint:
            return (
                f"{other.service} has Φ {other.fingerprint}, {self.service} has Φ {self.fingerprint}: give both the"
                " same --layout"
            )
        if other.version != self.version:
            return f"{other.service} is canskin {other.version}, {self.service} is {self.version}: install one version"
        return ""


#: Key expression of the peers of all skins.
EVERY_KEY: Final = "canskin/*/alive/*/*"
#: A token that is taken: other programs may declare any key that `EVERY_KEY` intersects, such as ``canskin/**``.
_TOKEN: Final = re.compile(r"canskin/([\w-]{1,64})/alive/([\w-]{1,64})/([\w.+!~-]{1,200})", re.ASCII)


def client_version() -> str:
    """Return the version of canskin in this environment."""
    return version("canskin-client")


def new_peer(skin: str, service: str, fingerprint: str) -> Peer:
    """Return the peer of a new service of this installation."""
    return Peer(skin, service, secrets.token_hex(INSTANCE_BYTES), client_version(), fingerprint)


def peer_of_key(key: str) -> Peer | None:
    """Return the peer whose token is `key`; None if its names are none, as of a program that imitates a service.

    So a name of a peer has letters, digits and a few signs, whoever prints the name or makes another key of it.
    """
    found = _TOKEN.fullmatch(key)
    if found is None:
        return None
    skin, service, about = found.groups()
    instance, *rest = about.split(SEPARATOR, 2)
    instance, _, scheduling = instance.partition(SCHEDULING)
    return msgspec.structs.replace(Peer(skin, service, instance, *rest), scheduling=scheduling)


class Roll:
    """The present tokens of each service."""

    def __init__(self) -> None:
        self._keys: dict[str, set[str]] = {}

    def note(self, service: str, key: str, is_there: bool) -> bool:
        """Note that a token came or went; tell whether the service came with its first or went with its last."""
        was_there = self.holds(service)
        keys = self._keys.setdefault(service, set())
        if is_there:
            keys.add(key)
        else:
            keys.discard(key)
        if not keys:
            del self._keys[service]
        return self.holds(service) != was_there

    def holds(self, service: str) -> bool:
        """Tell whether any token of a service is present."""
        return service in self._keys
