"""A skin on ROS 2's wire, as a reader with other libraries sees it."""

import math
import threading
from collections.abc import Iterator
from itertools import count
from typing import Any

import msgspec
import numpy as np
import pytest
import zenoh
from zenoh_ros2_sdk import ROS2ServiceClient, ZenohSession
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability
from zenoh_ros2_sdk.utils import ros2_to_dds_type

from canskin.calibration_messages import CALIBRATION, CalibrationReply
from canskin.fabric import Fabric
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, MEASUREMENT
from canskin.messages import Topic as FabricTopic
from health.state import ViewState
from skin.wall_times import Clocks
from tests import messages as make
from tests.health.helpers import Messages
from tests.views.ros2.reader import (
    PATIENCE_S,
    TYPE_HASHES,
    DiagnosticArray,
    Image,
    MarkerArray,
    PointCloud2,
    Reader,
    String,
    Topic,
    TriggerReply,
    WrenchStamped,
    key,
    publish,
    time_ns,
)
from views.ros2.bridge import Bridge
from views.ros2.names import RELIABLE, SENSOR_DATA
from views.ros2.node import RosNode
from views.ros2.topics import ROS_TOPICS, Translator
from views.ros2.types import TRIGGER, key_type

WALL_NS = 1_700_000_000_000_000_000
SAMPLED_NS = 1_000_000_000
#: Of the client that asks a service.
GID = bytes(range(16))


class Setup:
    """Hub, bridge and reader in one process; the hub is the router of the ROS network, too."""

    def __init__(self, hub: Fabric, endpoint: str, messages: Messages) -> None:
        self.hub, self.messages = hub, messages
        layout = messages.layout
        self.fabric = Fabric(layout.name, "ros2", endpoint)
        self.node = RosNode(endpoint, domain=7, namespace="/arm/palm", name="canskin")
        self.bridge = Bridge(layout, self.fabric, self.node, "palm_link")
        self.reader = Reader(endpoint)

    def topic(self, name: str, ros_type: str, kind: type) -> Topic:
        topic = self.reader.subscribe(f"/arm/palm/{name}", ros_type, kind, 7)
        of_bridge = next(each for each in ROS_TOPICS if each.name == name)
        while not self.bridge._publishers[of_bridge].has_readers:
            self.bridge.turn(0.01)
        self.clocks()
        return topic

    def publish(self, topic: FabricTopic, message: msgspec.Struct) -> None:
        """Publish on the fabric, and have the bridge publish what follows."""
        publish(self.hub, topic, message)
        self.bridge.turn(PATIENCE_S)

    def clocks(self) -> None:
        self.publish(
            MEASUREMENT,
            make.measurement(sampled_mono_ns=SAMPLED_NS, wall_offset_ns=WALL_NS),
        )

    def close(self) -> None:
        self.reader.close()
        self.node.close()
        self.fabric.close()


@pytest.fixture
def setup(hub: Fabric, endpoint: str, messages: Messages) -> Iterator[Setup]:
    setup = Setup(hub, endpoint, messages)
    yield setup
    setup.close()


def test_images_are_equal_bit_for_bit_and_nan_where_not_measured(setup: Setup) -> None:
    images = setup.topic("image", "sensor_msgs/msg/Image", Image)
    random = np.random.default_rng(1)
    for cycle in range(1, 51):
        pixels = random.random((16, 16), np.float32)
        setup.publish(IMAGE, setup.messages.image(cycle, sync_s=1 + cycle / 100, pixels=pixels, invalid=(3,)))
        image, attached = images.next()
        got = np.array(image.data, np.uint8).view("<f4").reshape(16, 16)
        valid = setup.messages.layout.phi().block_of_taxel.reshape(16, 16) != 3
        assert np.array_equal(got[valid].view("u4"), pixels[valid].view("u4"))
        assert np.isnan(got[~valid]).all()
        assert (image.height, image.width, image.encoding, image.step) == (16, 16, "32FC1", 64)
        assert time_ns(image.header) == round((1 + cycle / 100) * 1e9) + WALL_NS
        assert image.header.frame_id == "palm_link"
        assert attached.sequence_id == cycle
        assert len(attached.gid) == 16


def test_heat_map_is_of_8_bits_and_grey_where_not_measured(setup: Setup) -> None:
    heat = setup.topic("heat_map", "sensor_msgs/msg/Image", Image)
    pixels = np.zeros((16, 16), np.float32)
    pixels[0, 0] = setup.messages.layout.taxels.force_max_n
    pixels[0, 1] = 10.0
    setup.publish(IMAGE, setup.messages.image(pixels=pixels, invalid=(3,)))
    image, _ = heat.next()
    got = np.array(image.data, np.uint8).reshape(16, 16, 3)
    is_valid = setup.messages.layout.phi().block_of_taxel.reshape(16, 16) != 3
    assert (image.encoding, image.step) == ("rgb8", 48)
    assert (got[~is_valid] == 128).all()
    assert is_valid[0, :2].all()
    assert got[0, 0].tolist() == got[0, 1].tolist() == [253, 231, 36]  # the end of viridis
    assert got[15, 15].tolist() == [68, 1, 84]


def points_of(cloud: Any) -> np.ndarray:
    kinds = {7: "<f4", 6: "<u4", 2: "u1"}
    dtype = np.dtype(
        {
            "names": [each.name for each in cloud.fields],
            "formats": [kinds[each.datatype] for each in cloud.fields],
            "offsets": [each.offset for each in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    return np.array(cloud.data, np.uint8).view(dtype).reshape(cloud.height, cloud.width)


def test_cloud_has_every_taxel_at_its_place_with_force_and_validity(setup: Setup) -> None:
    clouds = setup.topic("points", "sensor_msgs/msg/PointCloud2", PointCloud2)
    setup.publish(IMAGE, setup.messages.image(invalid=(3,)))
    cloud, _ = clouds.next()
    points = points_of(cloud)
    pitch_m = setup.messages.layout.taxels.pitch_m
    assert points.shape == (16, 16)
    assert points["x"][2, 5] == np.float32((5 - 7.5) * pitch_m)
    assert points["y"][2, 5] == np.float32((2 - 7.5) * pitch_m)
    assert np.array_equal(points["force"], setup.messages.grid())
    assert np.array_equal(points["valid"] == 0, setup.messages.layout.phi().block_of_taxel.reshape(16, 16) == 3)
    assert cloud.row_step == 16 * cloud.point_step


def test_contacts_have_places_forces_and_identities(setup: Setup) -> None:
    clouds = setup.topic("contacts", "sensor_msgs/msg/PointCloud2", PointCloud2)
    contacts = setup.messages.contacts(row=2.25, column=3.5)
    setup.publish(CONTACTS, setup.messages.contacts(blind=True))  # says nothing, so nothing goes out
    setup.publish(CONTACTS, contacts)
    (point,) = points_of(clouds.next()[0])[0]
    pitch_m, contact = setup.messages.layout.taxels.pitch_m, contacts.contacts[0]
    assert (point["identity"], point["taxels"], point["invalid_taxels"]) == (7, 113, 4)
    assert (point["x"], point["y"]) == (np.float32((3.5 - 7.5) * pitch_m), np.float32((2.25 - 7.5) * pitch_m))
    assert point["force"] == np.float32(contact.force_n)
    assert point["doubtful"] == 0
    doubtful = msgspec.structs.replace(contact, doubtful_since_mono_ns=5)
    setup.publish(CONTACTS, msgspec.structs.replace(contacts, contacts=[doubtful]))
    assert points_of(clouds.next()[0])["doubtful"].tolist() == [[1]]
    setup.publish(CONTACTS, msgspec.structs.replace(contacts, contacts=[]))
    assert points_of(clouds.next()[0]).size == 0


def test_markers_of_contacts_replace_those_before(setup: Setup) -> None:
    markers = setup.topic("contact_markers", "visualization_msgs/msg/MarkerArray", MarkerArray)
    setup.publish(CONTACTS, setup.messages.contacts(row=7.5, column=9.5))
    all_before, disc, words = markers.next()[0].markers
    pitch_m = setup.messages.layout.taxels.pitch_m
    assert all_before.action == 3  # DELETEALL
    assert (disc.ns, disc.id, disc.type, disc.pose.position.x) == ("contacts", 7, 3, 2 * pitch_m)
    assert disc.scale.x == pytest.approx(2 * math.sqrt(113 / math.pi) * pitch_m)  # the area of its taxels
    assert (words.type, words.text) == (9, "376.6 mN")


def test_label_is_a_text_and_empty_without_contact(setup: Setup) -> None:
    labels = setup.topic("label", "std_msgs/msg/String", String)
    setup.publish(LABEL, setup.messages.label("ring"))
    assert labels.next()[0].data == "ring"
    setup.publish(LABEL, setup.messages.label("ring", valid_sums=0))  # void
    setup.publish(LABEL, setup.messages.label(""))
    assert labels.next()[0].data == ""


def test_wrench_is_of_the_whole_skin_about_its_origin_and_comes_only_whole(setup: Setup) -> None:
    wrenches = setup.topic("wrench", "geometry_msgs/msg/WrenchStamped", WrenchStamped)
    pixels = np.zeros((16, 16), np.float32)
    pixels[2, 5] = 0.25
    setup.publish(IMAGE, setup.messages.image(pixels=np.ones((16, 16), np.float32), invalid=(3,)))
    setup.publish(IMAGE, setup.messages.image(pixels=pixels))
    got, pitch_m = wrenches.next()[0], setup.messages.layout.taxels.pitch_m
    force, torque = got.wrench.force, got.wrench.torque
    assert got.header.frame_id == "palm_link"
    assert (force.x, force.y, force.z) == (0, 0, 0.25)  # z is into the skin
    assert (torque.x, torque.y, torque.z) == pytest.approx(((2 - 7.5) * pitch_m / 4, -(5 - 7.5) * pitch_m / 4, 0))


def test_diagnostics_name_what_is_wrong(hub: Fabric, endpoint: str, messages: Messages) -> None:
    reader = Reader(endpoint)
    topic = reader.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", DiagnosticArray)
    fabric = Fabric("palm", "ros2", endpoint)
    node = RosNode(endpoint, domain=0, namespace="/palm", name="canskin")
    now_s = [100.0]
    bridge = Bridge(messages.layout, fabric, node, "palm", clock_s=lambda: now_s[0])
    bridge.turn(0)
    topic.next()  # none was there yet
    off = "dead: the gateway's controller is bus-off"
    status = messages.gateway(nmt=((5, 5, 255, 5), (5, 5, 5, 5)), links=("active", "bus_off"), troubles=("", off))
    publish(hub, GATEWAY, status)
    now_s[0] += 1.0
    bridge.turn(PATIENCE_S)
    skin, left, right = topic.next()[0].status
    assert (left.level, left.message) == (1, "1 of 4 nodes not operational")
    assert (right.level, right.message) == (2, off)
    assert skin.level == 2
    assert "bus-off" in skin.message
    assert {each.key: each.value for each in left.values}["nodes not operational"] == "3"
    publish(hub, GATEWAY, messages.gateway(nmt=((255, 255, 255, 255), (5, 5, 5, 5))))
    now_s[0] += 1.0
    bridge.turn(PATIENCE_S)
    skin, left, right = topic.next()[0].status
    assert (left.level, left.message) == (2, "4 of 4 nodes not operational")
    assert (skin.level, right.level) == (2, 0)
    now_s[0] += 5.0
    bridge.turn(0)
    assert topic.next()[0].status[1].level == 3
    for each in (reader, node, fabric):
        each.close()


def test_tokens_are_those_of_rmw_zenoh(setup: Setup) -> None:
    node = NodeEntity(
        domain_id=7, session_id=setup.node.node.session, node_id=0, node_name="canskin", namespace="/arm/palm"
    )
    sensor = QosProfile(reliability=QosReliability.BEST_EFFORT, durability=QosDurability.VOLATILE, history_depth=5)
    expected = [node_liveliness_keyexpr(node)]
    services = [(TRIGGER, EntityKind.SERVICE, "/arm/palm/tare", QosProfile())]
    publishers = [
        (
            topic.ros_type,
            EntityKind.PUBLISHER,
            topic.name if topic.name.startswith("/") else f"/arm/palm/{topic.name}",
            QosProfile() if topic.name == "/diagnostics" else sensor,
        )
        for topic in ROS_TOPICS
    ]
    for number, (ros_type, kind, name, qos) in enumerate([*publishers, *services], 1):
        endpoint = EndpointEntity(
            node=node, entity_id=number, kind=kind, name=name, dds_type_name=ros2_to_dds_type(ros_type),
            type_hash=TYPE_HASHES[ros_type], qos=qos.encode(), gid=b"",
        )  # fmt: skip
        expected.append(endpoint_liveliness_keyexpr(endpoint))
    while len(tokens := setup.reader.tokens()) < len(expected):
        pass  # they come one after the other
    assert sorted(tokens) == sorted(expected)
    assert (SENSOR_DATA.token, RELIABLE.token) == (sensor.encode(), QosProfile().encode())


def test_tokens_go_with_the_node(setup: Setup) -> None:
    setup.node.close()
    while setup.reader.tokens():
        pass


@pytest.mark.parametrize("ros_type", TYPE_HASHES)
def test_type_hashes_are_those_of_the_distributions(ros_type: str) -> None:
    assert key_type(ros_type) == f"{ros2_to_dds_type(ros_type)}/{TYPE_HASHES[ros_type]}"


def ask(setup: Setup, service: str) -> Any:
    """Ask a service of the node; return the replies to come."""
    return setup.reader.session.get(
        key(service, TRIGGER, 7),
        payload=b"\0\1\0\0\0",
        attachment=Attachment(sequence_id=5, timestamp_ns=1, gid=GID).to_bytes(),
        target=zenoh.QueryTarget.ALL_COMPLETE,
        timeout=PATIENCE_S,
    )


@pytest.mark.parametrize("is_done", [True, False])
def test_tare_asks_the_gateway(setup: Setup, is_done: bool) -> None:
    asked: list[object] = []

    def answer(request: object, reply: object) -> None:
        asked.append(request)
        reply(CalibrationReply(is_done=is_done, text="the words"))  # type: ignore[operator]

    setup.hub.answer(CALIBRATION, answer)
    # Until both services are known, nobody answers, or the node says that no gateway does.
    answered = next(each for _ in count() for each in ask(setup, "/arm/palm/tare") if asked)
    reply = TriggerReply.deserialize(answered.ok.payload.to_bytes())
    attached = Attachment.from_bytes(answered.ok.attachment.to_bytes())
    assert (reply.success, reply.message) == (is_done, "the words")
    assert (attached.sequence_id, attached.gid) == (5, GID)
    assert len(asked) == 1


def test_every_error_of_a_service_is_an_answer(setup: Setup) -> None:
    def fail() -> tuple[bool, str]:
        raise ValueError("the reason")

    setup.node.serve_trigger("fail", fail)
    answered = next(each for _ in count() for each in ask(setup, "/arm/palm/fail"))
    reply = TriggerReply.deserialize(answered.ok.payload.to_bytes())
    assert (reply.success, reply.message) == (False, "the reason")


def test_closing_does_not_wait_for_an_answer(setup: Setup) -> None:
    began, may_end, ended = threading.Event(), threading.Event(), []

    def act() -> tuple[bool, str]:
        began.set()
        ended.append(may_end.wait(PATIENCE_S))
        return True, ""

    setup.node.serve_trigger("slow", act)
    replies = [ask(setup, "/arm/palm/slow")]
    while not began.wait(1.0) and len(replies) < PATIENCE_S:  # the reader may not have known of the service yet
        replies.append(ask(setup, "/arm/palm/slow"))
    assert began.is_set()
    setup.node.close()
    assert not ended
    may_end.set()
    del replies


def test_a_client_of_another_library_tares(setup: Setup, endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    setup.hub.answer(CALIBRATION, lambda _, reply: reply(CalibrationReply(is_done=True, text="new zero")))
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", 'mode="client"')
    monkeypatch.setattr(ZenohSession, "_instance", ZenohSession("127.0.0.1", int(endpoint.rpartition(":")[2])))
    client = ROS2ServiceClient(
        "/arm/palm/tare",
        TRIGGER,
        request_definition="uint8 structure_needs_at_least_one_member",
        response_definition="bool success\nstring message",
        domain_id=7,
        type_hash=TYPE_HASHES[TRIGGER],
        timeout=1.0,
    )
    # Until both services are known, nobody answers, or the node says that no gateway does.
    calls = (client.call(structure_needs_at_least_one_member=0) for _ in range(round(PATIENCE_S)))
    answer = next(each for each in calls if each is not None and each.success)
    client.close()
    client.session_mgr.session.close()
    assert (answer.success, answer.message) == (True, "new zero")


def test_no_image_goes_out_before_the_clocks_of_the_gateway_are_known(messages: Messages) -> None:
    translator = Translator(messages.layout, "palm", ViewState(messages.layout))
    clocks = Clocks(sampled_mono_ns=0, wall_offset_ns=WALL_NS)
    drafts = [
        len(list(translator.take(each, 0.0)))
        for each in (messages.image(), messages.contacts(), clocks, messages.image())
    ]
    assert drafts == [0, 0, 0, 5]
