"""Names on the wire of rmw_zenoh: keys of topics, liveliness tokens, QoS, and attachments.

The forms are those of rmw_zenoh's ``docs/design.md`` and of its sources ``liveliness_utils.cpp`` and
``attachment_helpers.cpp``.
"""

import hashlib
import os
import re
import struct
from typing import Final, Literal, NamedTuple

from canskin.errors import InputError

#: First part of the tokens of nodes, publishers and services.
ADMIN_SPACE: Final = "@ros2_lv"
#: Bytes of the identity of a publisher.
GID_BYTES: Final = 16
#: Largest domain of ROS 2 (``ROS_DOMAIN_ID``).
DOMAIN_MAX: Final = 232
#: Type hash of all types on Humble, which has no type hashes.
NO_TYPE_HASH: Final = "TypeHashNotSupported"
_ATTACHMENT: Final = struct.Struct("<qqB")
_NAMESPACE: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+|/")


class Qos(NamedTuple):
    """Quality of service: volatile, the last `depth` messages, no deadlines."""

    best_effort: bool
    depth: int

    @property
    def token(self) -> str:
        """Text in a token; empty fields are the defaults: reliable, volatile, keep last."""
        return f"{2 if self.best_effort else ''}::,{self.depth}:,:,:,,"


#: rmw_qos_profile_sensor_data.
SENSOR_DATA: Final = Qos(best_effort=True, depth=5)
#: rmw_qos_profile_default, and that of services.
RELIABLE: Final = Qos(best_effort=False, depth=10)


class Node(NamedTuple):
    """A node of ROS: the zenoh session it lives in, its namespace (``/palm``) and its name."""

    domain: int
    session: str
    namespace: str
    name: str

    @property
    def token(self) -> str:
        """Key of the node's liveliness token."""
        return "/".join((*self._session_parts(0, "NN"), *self._name_parts()))

    def endpoint_token(self, number: int, kind: Literal["MP", "SS"], name: str, wire_type: str, qos: Qos) -> str:
        """Return the key of the liveliness token of a publisher (MP) or of a service's server (SS).

        Parameters
        ----------
        number : int
            Of the endpoint, from 1; different for every endpoint of the session.
        name : str
            Of the topic or service, with its namespace.
        wire_type : str
            Type and hash, as `wire_type` returns them.
        """
        return "/".join(
            (*self._session_parts(number, kind), *self._name_parts(), name.replace("/", "%"), wire_type, qos.token)
        )

    def data_key(self, name: str, wire_type: str) -> str:
        """Return the key of the messages of a topic, or of the requests to a service."""
        return f"{self.domain}/{name.strip('/')}/{wire_type}"

    def full_name(self, name: str) -> str:
        """Return a relative name with the namespace before it; a name that begins with a slash stays."""
        return name if name.startswith("/") else f"{self.namespace.rstrip('/')}/{name}"

    def _session_parts(self, number: int, kind: str) -> tuple[str, ...]:
        return ADMIN_SPACE, str(self.domain), self.session, "0", str(number), kind

    def _name_parts(self) -> tuple[str, ...]:
        enclave = "%"
        return enclave, self.namespace.replace("/", "%"), self.name


def wire_type(ros_type: str, type_hash: str) -> str:
    """Return type and hash as keys have them.

    Examples
    --------
    >>> wire_type("sensor_msgs/msg/Image", "RIHS01_d31d")
    'sensor_msgs::msg::dds_::Image_/RIHS01_d31d'
    """
    package, kind, name = ros_type.split("/")
    return f"{package}::{kind}::dds_::{name}_/{type_hash}"


def gid_of(token: str) -> bytes:
    """Return the identity of an endpoint, which every attachment of its messages carries."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()


def attachment(number: int, time_ns: int, gid: bytes) -> bytes:
    """Return the attachment of a message: its number, when it was sent on the wall clock, and who sent it."""
    return _ATTACHMENT.pack(number, time_ns, len(gid)) + gid


def parse_attachment(content: bytes) -> tuple[int, int, bytes] | None:
    """Return number, time and sender of an attachment; None if it has another form."""
    if len(content) != _ATTACHMENT.size + GID_BYTES:
        return None
    number, time_ns, size = _ATTACHMENT.unpack_from(content)
    return (number, time_ns, content[_ATTACHMENT.size :]) if size == GID_BYTES else None


def check_domain(domain: int | None) -> int:
    """Return the domain: the given one, else that of ``ROS_DOMAIN_ID``, else 0."""
    given = os.environ.get("ROS_DOMAIN_ID", "0") or "0" if domain is None else str(domain)
    if not given.isdecimal() or int(given) > DOMAIN_MAX:
        where = "ROS_DOMAIN_ID" if domain is None else "--domain"
        raise InputError(f"{where}: expected 0 to {DOMAIN_MAX}, got {given}")
    return int(given)


def check_namespace(namespace: str) -> str:
    """Return a namespace with its leading slash and no trailing slash."""
    found = "/" + namespace.strip("/")
    if not _NAMESPACE.fullmatch(found):
        raise InputError(f"--namespace: expected letters, digits and _, such as /robot/palm, got '{namespace}'")
    return found
