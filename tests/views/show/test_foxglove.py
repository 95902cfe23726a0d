"""What other readers find in the files made for Foxglove: mcap with the schemas of the file itself."""

import asyncio
import json
import struct
import threading
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import websockets
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from canskin.errors import InputError
from canskin.fabric import Fabric
from canskin.messages import CONTACTS, IMAGE
from recording.export_command import export
from shell.service import StopSignal
from skin.wall_times import CLOCKS, Clocks
from tests import messages as make
from tests.health.helpers import Messages
from tests.layouts import tube_layout
from tests.recording.helpers import COUNT, OFFSET_NS, SET_NS, pixels
from views.show.command import draw_live
from views.show.foxglove_canvas import FoxgloveCanvas
from views.show.target import Address


def decoded(schema: Any, data: bytes) -> Any:
    if schema.encoding == "jsonschema":
        return json.loads(data)
    assert schema.encoding == "protobuf"
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(data)


def messages_of(path: Path, topic: str) -> list[tuple[int, str, Any]]:
    with path.open("rb") as file:
        return [
            (message.log_time, schema.name, decoded(schema, message.data))
            for schema, channel, message in make_reader(file).iter_messages(topics=[topic])
            if schema is not None
        ]


def test_recording_becomes_a_file_with_every_image_bit_for_bit(run: Path) -> None:
    export(run, to="foxglove")
    path = run.with_name("run-foxglove.mcap")
    times_ns = [OFFSET_NS + 10 * cycle + SET_NS * (cycle > 2) for cycle in range(1, COUNT + 1)]
    for topic, name in (("/image", "foxglove.RawImage"), ("/taxels", "foxglove.Grid")):
        found = messages_of(path, topic)
        assert [(time_ns, kind) for time_ns, kind, _ in found] == [(time_ns, name) for time_ns in times_ns]
        assert np.isnan(np.frombuffer(found[0][2].data, "<f4")).all()
        for cycle, (_, _, image) in enumerate(found[1:], 2):
            assert image.data == pixels(cycle).tobytes()
    image = messages_of(path, "/image")[0][2]
    assert (image.encoding, image.width, image.height, image.step) == ("32FC1", 16, 16, 64)


def test_cells_lie_in_the_places_of_the_taxels(run: Path) -> None:
    export(run, to="foxglove")
    _, _, grid = messages_of(run.with_name("run-foxglove.mcap"), "/taxels")[0]
    assert (grid.column_count, grid.cell_size.x, grid.row_stride, grid.cell_stride) == (16, 0.004, 64, 4)
    assert grid.pose.position.x == pytest.approx(-0.032)  # the corner of the first cell
    assert [(field.name, field.offset) for field in grid.fields] == [("force", 0)]


def test_contacts_curves_and_log(run: Path) -> None:
    export(run, to="foxglove")
    path = run.with_name("run-foxglove.mcap")
    scenes = [scene for _, _, scene in messages_of(path, "/contacts")]
    assert [len(scene.entities[0].cylinders) for scene in scenes] == [0, 1, 0, 0]
    assert scenes[1].entities[0].texts[0].text == "3: 250.0 mN"
    position = scenes[1].entities[0].cylinders[0].pose.position
    assert (position.x, position.y) == (pytest.approx((2.5 - 7.5) * 0.004), pytest.approx((1.5 - 7.5) * 0.004))
    assert [value["value"] for _, _, value in messages_of(path, "/figures/valid_share")] == [0.0, 1.0, 1.0, 1.0]
    assert "waiting for the gateway [gateway-absent]" in [line.message for _, _, line in messages_of(path, "/log")]


def test_doubtful_contacts_have_another_colour_and_a_question_mark(messages: Messages, tmp_path: Path) -> None:
    canvas, contact = FoxgloveCanvas(messages.layout, tmp_path / "it.mcap"), messages.contacts().contacts[0]
    canvas.contacts(1, 1, [contact, msgspec.structs.replace(contact, doubtful_since_mono_ns=5)])
    canvas.close()
    ((_, _, scene),) = messages_of(tmp_path / "it.mcap", "/contacts")
    assert [each.text for each in scene.entities[0].texts] == ["7: 376.6 mN", "7: 376.6 mN?"]
    assert [each.color.b for each in scene.entities[0].cylinders] == [1.0, 0.0]


def test_a_skin_that_is_no_grid_is_a_cloud_of_points(tmp_path: Path) -> None:
    layout = tube_layout()
    surface, canvas = layout.taxels.surface, FoxgloveCanvas(layout, tmp_path / "it.mcap")
    forces_n = np.linspace(0, 0.02, 96, dtype=np.float32)[None].copy()
    forces_n[0, :2] = np.nan
    canvas.image(1, 1, forces_n)
    contact = make.contact(row=0.0, column=17.0, position_m=(0.0, 0.02, 0.01), normal=(0.0, 1.0, 0.0))
    canvas.contacts(1, 1, [contact])
    canvas.close()
    assert not messages_of(tmp_path / "it.mcap", "/image")
    ((_, kind, cloud),) = messages_of(tmp_path / "it.mcap", "/taxels")
    assert kind == "foxglove.PointCloud"
    types = {1: "u1", 7: "<f4"}  # foxglove.PackedElementField: UINT8, FLOAT32
    names = {each.name: (types[each.type], each.offset) for each in cloud.fields}
    points = np.frombuffer(cloud.data, np.dtype({**names, "end": ("u1", cloud.point_stride - 1)}))  # type: ignore[call-overload]
    for columns, wanted in (
        (("x", "y", "z"), surface.positions_m),
        (("normal_x", "normal_y", "normal_z"), surface.normals),
    ):
        np.testing.assert_allclose(np.stack([points[name] for name in columns], axis=1), wanted, atol=1e-7)
    np.testing.assert_array_equal(points["force"], forces_n[0])
    assert points["valid"].tolist() == [0, 0] + [1] * 94
    (entity,) = messages_of(tmp_path / "it.mcap", "/contacts")[0][2].entities
    disc, arrow = entity.cylinders[0].pose, entity.arrows[0].pose
    assert (disc.position.x, disc.position.y, disc.position.z) == contact.position_m
    assert direction(disc, (0, 0, 1)) == pytest.approx((0, 1, 0))
    assert direction(arrow, (1, 0, 0)) == pytest.approx((0, -1, 0))  # Foxglove's arrows point along x
    assert arrow.position.y == pytest.approx(0.02 + 4 * surface.pitch_m)


def direction(pose: Any, axis: tuple[int, int, int]) -> Any:
    """Return where a pose turns an axis."""
    turn = pose.orientation
    return Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).apply(axis)


def test_the_app_gets_the_images_of_a_live_skin(hub: Fabric, endpoint: str, messages: Messages) -> None:
    canvas, stop = FoxgloveCanvas(messages.layout, Address("127.0.0.1", 0)), StopSignal()
    fabric = Fabric("palm", "show", endpoint)
    drawing = threading.Thread(target=draw_live, args=(messages.layout, fabric, canvas, stop))
    drawing.start()

    def publish() -> None:
        hub.publish(CLOCKS, Clocks(sampled_mono_ns=0, wall_offset_ns=OFFSET_NS))
        hub.publish(IMAGE, messages.image())
        hub.publish(CONTACTS, messages.contacts())

    image = asyncio.run(first_image(canvas.address, publish))
    stop.set()
    drawing.join()
    canvas.close()
    fabric.close()
    assert image.data == messages.grid().tobytes()


async def first_image(address: str, publish: Any) -> Any:
    """Do as the app does (foxglove.websocket.v1): subscribe to the images, and return the first."""
    async with websockets.connect(address, subprotocols=["foxglove.sdk.v1"]) as app:  # type: ignore[list-item]
        image: Any = None
        while True:
            publish()
            try:
                told = await asyncio.wait_for(app.recv(), 0.05)
            except TimeoutError:
                continue
            if isinstance(told, str):
                advertised = json.loads(told)
                for channel in advertised.get("channels", []):
                    if channel["topic"] == "/image":
                        image = channel
                        subscription = {"id": 1, "channelId": channel["id"]}
                        await app.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
            elif told[0] == 1:  # message data: subscription, log time, payload
                assert struct.unpack_from("<I", told, 1) == (1,)
                return decoded(Described(image), told[13:])


class Described:
    """The schema that a server advertises, as `decoded` reads it."""

    def __init__(self, channel: dict[str, str]) -> None:
        import base64

        self.name, self.encoding, self.data = channel["schemaName"], "protobuf", base64.b64decode(channel["schema"])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "expected --rerun or --foxglove, got neither"),
        (["--rerun", "--foxglove"], "got both"),
        (["--rerun", "run.mcap"], "new file that ends in .rrd"),
        (["--foxglove", "run.rrd"], "new file that ends in .mcap"),
        (["--foxglove", "nowhere/run.mcap"], "folder for the view does not exist"),
    ],
)
def test_wrong_targets_are_errors(arguments: list[str], says: str) -> None:
    from shell.command import build_app

    with pytest.raises(InputError, match=says):
        build_app(["show", *arguments]).meta(["show", *arguments])
