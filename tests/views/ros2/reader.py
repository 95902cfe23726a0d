"""A reader of ROS 2's wire with other libraries than the writer: zenoh_ros2_sdk for the keys, pycdr2 for messages."""

import queue
import threading
from dataclasses import make_dataclass
from typing import Any

import msgspec
import zenoh
from pycdr2 import IdlStruct
from pycdr2.types import float32, float64, int32, sequence, uint8, uint32
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.keyexpr import topic_keyexpr
from zenoh_ros2_sdk.utils import ros2_to_dds_type

from canskin.fabric import Fabric
from canskin.messages import Topic as FabricTopic
from tests.processes import PATIENCE_S

#: Of ROS 2 Jazzy, as its nodes tell them (`ros2 topic info -v`): the repository copper-project/copper-rs lists those of
#: every type in ``all_rihs.md``, made by a script on an installation of Jazzy.
TYPE_HASHES = {
    "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "visualization_msgs/msg/MarkerArray": "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "geometry_msgs/msg/WrenchStamped": "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "std_srvs/srv/Trigger": "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}


def _struct(name: str, /, **fields: Any) -> Any:
    """Return the class of a message with fields in this order."""
    return make_dataclass(name, fields.items(), bases=(IdlStruct,))


Time = _struct("Time", sec=int32, nanosec=uint32)
Header = _struct("Header", stamp=Time, frame_id=str)
Image = _struct(
    "Image",
    header=Header,
    height=uint32,
    width=uint32,
    encoding=str,
    is_bigendian=uint8,
    step=uint32,
    data=sequence[uint8],
)
PointField = _struct("PointField", name=str, offset=uint32, datatype=uint8, count=uint32)
PointCloud2 = _struct(
    "PointCloud2",
    header=Header,
    height=uint32,
    width=uint32,
    fields=sequence[PointField],
    is_bigendian=bool,
    point_step=uint32,
    row_step=uint32,
    data=sequence[uint8],
    is_dense=bool,
)
Point = _struct("Point", x=float64, y=float64, z=float64)
Quaternion = _struct("Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = _struct("Pose", position=Point, orientation=Quaternion)
Colour = _struct("Colour", r=float32, g=float32, b=float32, a=float32)
CompressedImage = _struct("CompressedImage", header=Header, format=str, data=sequence[uint8])
UV = _struct("UV", u=float32, v=float32)
MeshFile = _struct("MeshFile", filename=str, data=sequence[uint8])
Marker = _struct(
    "Marker",
    header=Header,
    ns=str,
    id=int32,
    type=int32,
    action=int32,
    pose=Pose,
    scale=Point,
    color=Colour,
    lifetime=Time,
    frame_locked=bool,
    points=sequence[Point],
    colors=sequence[Colour],
    texture_resource=str,
    texture=CompressedImage,
    uv_coordinates=sequence[UV],
    text=str,
    mesh_resource=str,
    mesh_file=MeshFile,
    mesh_use_embedded_materials=bool,
)
MarkerArray = _struct("MarkerArray", markers=sequence[Marker])
KeyValue = _struct("KeyValue", key=str, value=str)
DiagnosticStatus = _struct(
    "DiagnosticStatus", level=uint8, name=str, message=str, hardware_id=str, values=sequence[KeyValue]
)
DiagnosticArray = _struct("DiagnosticArray", header=Header, status=sequence[DiagnosticStatus])
Wrench = _struct("Wrench", force=Point, torque=Point)
WrenchStamped = _struct("WrenchStamped", header=Header, wrench=Wrench)
String = _struct("String", data=str)
TriggerReply = _struct("TriggerReply", success=bool, message=str)


def time_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def key(name: str, ros_type: str, domain: int = 0) -> str:
    return str(topic_keyexpr(domain, name, ros2_to_dds_type(ros_type), TYPE_HASHES[ros_type]))


class Reader:
    """A client of the router."""

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("scouting/gossip/enabled", "false")
        self.session = zenoh.open(config)

    def tokens(self, pattern: str = "@ros2_lv/**") -> list[str]:
        return [str(reply.ok.key_expr) for reply in self.session.liveliness().get(pattern) if reply.ok is not None]

    def subscribe(self, name: str, ros_type: str, kind: Any, domain: int = 0) -> "Topic":
        return Topic(self.session, key(name, ros_type, domain), kind)

    def close(self) -> None:
        self.session.close()


class Topic:
    """Messages of a topic with their attachments."""

    def __init__(self, session: Any, data_key: str, kind: Any) -> None:
        self._kind = kind
        self._came: queue.Queue[tuple[bytes, bytes]] = queue.Queue()
        self._kept = session.declare_subscriber(
            data_key, lambda sample: self._came.put((sample.payload.to_bytes(), sample.attachment.to_bytes()))
        )

    def next(self) -> tuple[Any, Attachment]:
        payload, attached = self._came.get(timeout=PATIENCE_S)
        return self._kind.deserialize(payload), Attachment.from_bytes(attached)


def publish(hub: Fabric, topic: FabricTopic, message: msgspec.Struct) -> None:
    """Publish on the fabric when the hub knows of a subscriber: its declaration is on the way for a while."""
    probe, pause = hub._session.declare_publisher(f"{hub._prefix}/{topic.name}"), threading.Event()
    while not probe.matching_status.matching:
        pause.wait(0.005)
    probe.undeclare()
    hub.publish(topic, message)
