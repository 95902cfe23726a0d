"""The types of ROS 2 that a skin uses: classes, CDR and hashes by rosbags, which needs no ROS."""

from functools import cache
from typing import TYPE_CHECKING, Any, Final

from shell.extras import not_installed
from views.ros2.names import NO_TYPE_HASH, wire_type

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMAGE: Final = "sensor_msgs/msg/Image"
POINT_CLOUD: Final = "sensor_msgs/msg/PointCloud2"
MARKERS: Final = "visualization_msgs/msg/MarkerArray"
DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
TEXT: Final = "std_msgs/msg/String"
WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
TRIGGER: Final = "std_srvs/srv/Trigger"
TRIGGER_REPLY: Final = "std_srvs/srv/Trigger_Response"

#: Of std_srvs, of which rosbags has no types. An empty request has a byte on the wire. ``char`` is ``uint8`` in IDL, of
#: which hashes are made.
_SERVICE_FIELDS: Final = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "service_msgs/msg/ServiceEventInfo": (
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number"
    ),
    "std_srvs/srv/Trigger_Request": "uint8 structure_needs_at_least_one_member",
    TRIGGER_REPLY: "bool success\nstring message",
    "std_srvs/srv/Trigger_Event": (
        "service_msgs/ServiceEventInfo info\n"
        "std_srvs/srv/Trigger_Request[<=1] request\nstd_srvs/srv/Trigger_Response[<=1] response"
    ),
    TRIGGER: (
        "std_srvs/srv/Trigger_Request request_message\nstd_srvs/srv/Trigger_Response response_message\n"
        "std_srvs/srv/Trigger_Event event_message"
    ),
}


@cache
def store() -> "Typestore":
    """Return the types of ROS 2 Jazzy; those used here are the same from Iron to Lyrical."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise not_installed("ROS 2 needs rosbags", "ros2") from error
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def _services() -> "Typestore":
    """Return the types of the services."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    fields: dict[str, Any] = {}
    for name, text in _SERVICE_FIELDS.items():
        fields |= get_types_from_msg(text, name)
    found = get_typestore(Stores.EMPTY)
    found.register(_in_srv(fields))
    return found


def _of(ros_type: str) -> "Typestore":
    return _services() if "/srv/" in ros_type else store()


def _in_srv(tree: Any) -> Any:
    """Return fields of services with their names; rosbags puts them into ``srv/msg``."""
    if isinstance(tree, dict):
        return {_in_srv(name): _in_srv(fields) for name, fields in tree.items()}
    if isinstance(tree, list | tuple):
        return type(tree)(map(_in_srv, tree))
    return tree.replace("/srv/msg/", "/srv/") if isinstance(tree, str) else tree


def message(ros_type: str, **fields: Any) -> Any:
    """Build a message."""
    return _of(ros_type).types[ros_type](**fields)


def encoded(ros_type: str, content: Any) -> bytes:
    """Return the CDR of a message, little-endian, with its header of 4 bytes."""
    return bytes(_of(ros_type).serialize_cdr(content, ros_type, little_endian=True))


@cache
def key_type(ros_type: str, *, has_hash: bool = True) -> str:
    """Return type and hash (REP 2016) as keys have them; without hash as Humble has them."""
    return wire_type(ros_type, _of(ros_type).hash_rihs01(ros_type) if has_hash else NO_TYPE_HASH)
