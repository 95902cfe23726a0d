"""Who is on the fabric: what a service says of itself there, and whether two services can work together."""

import secrets
from importlib.metadata import version
from typing import Final

import msgspec

#: Random bytes that tell services of one name apart.
INSTANCE_BYTES: Final = 4
#: Between the parts of a token's last name; neither a version (PEP 440) nor a fingerprint has one.
SEPARATOR: Final = "-"


class Peer(msgspec.Struct, frozen=True):
    """A service on the fabric.

    Attributes
    ----------
    skin : str
        Name of its layout.
    service : str
    instance : str
        Tells services of one name apart: of two pages, one may leave.
    version : str
        Of canskin; empty when it is not known.
    fingerprint : str
        Of its Φ (`skin.measurement.Sbhe.fingerprint`); empty for a service that does not depend on one.
    """

    skin: str
    service: str
    instance: str
    version: str = ""
    fingerprint: str = ""

    @property
    def key(self) -> str:
        """The key of the liveliness token, ``canskin/SKIN/alive/SERVICE/INSTANCE-VERSION-FINGERPRINT``."""
        about = SEPARATOR.join((self.instance, self.version, self.fingerprint))
        return f"canskin/{self.skin}/alive/{self.service}/{about}"

    def difference(self, other: "Peer") -> str:
        """Say why `other` cannot work with this service; empty when it can, or when nothing is known of it."""
        if not self.fingerprint or not other.fingerprint:
            return ""
        if other.skin != self.skin:
            return (
                f"{other.service} on this hub is of skin '{other.skin}', {self.service} of '{self.skin}': they do not"
                " hear each other"
            )
        if other.fingerprint != self.fingerprint:
            return (
                f"{other.service} has Φ {other.fingerprint}, {self.service} has Φ {self.fingerprint}: give both the"
                " same --layout"
            )
        if other.version != self.version:
            return f"{other.service} is canskin {other.version}, {self.service} is {self.version}: install one version"
        return ""


#: The keys of every peer of every skin.
EVERY_KEY: Final = "canskin/*/alive/*/*"


def new_peer(skin: str, service: str, fingerprint: str) -> Peer:
    """Return what a service of this installation says of itself."""
    return Peer(skin, service, secrets.token_hex(INSTANCE_BYTES), version("canskin"), fingerprint)


def peer_of_key(key: str) -> Peer:
    """Return who has the token of `key`."""
    _, skin, _, service, about = key.split("/")
    return Peer(skin, service, *about.split(SEPARATOR, 2))


class Roll:
    """Who is there now: the instances of each service; a name without any takes no memory."""

    def __init__(self) -> None:
        self._instances: dict[str, set[str]] = {}

    def note(self, service: str, instance: str, is_there: bool) -> bool:
        """Note that an instance is there or gone; tell whether the service itself came or went by it."""
        was_there = self.holds(service)
        instances = self._instances.setdefault(service, set())
        if is_there:
            instances.add(instance)
        else:
            instances.discard(instance)
        if not instances:
            del self._instances[service]
        return self.holds(service) != was_there

    def holds(self, service: str) -> bool:
        """Tell whether any instance of a service is there."""
        return service in self._instances
