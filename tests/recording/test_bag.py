"""A recording as a bag of ROS 2, read by rosbags, and by the mcap library and pycdr2."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosReliability

from canskin.errors import InputError
from recording.export_command import export
from tests.documents import block
from tests.recording.helpers import COUNT, OFFSET_NS, SET_NS, pixels
from tests.views.ros2 import reader


@pytest.fixture
def bag(run: Path, tmp_path: Path) -> Path:
    export(run, to="ros2", out=tmp_path / "bag")
    return tmp_path / "bag"


def expected(cycle: int) -> np.ndarray:
    """Return the pixels of a cycle; no block of the first is valid."""
    return pixels(cycle) if cycle > 1 else np.full((16, 16), np.nan, np.float32)


def test_rosbags_reads_every_image_bit_for_bit(bag: Path) -> None:
    with AnyReader([bag]) as found:
        (images,) = [each for each in found.connections if each.topic == "/small/image"]
        assert images.msgtype == "sensor_msgs/msg/Image"
        assert images.ext.offered_qos_profiles[0].reliability is QosReliability.BEST_EFFORT
        read = [
            (time_ns, found.deserialize(content, images.msgtype))
            for _, time_ns, content in found.messages(connections=[images])
        ]
    assert [time_ns for time_ns, _ in read] == [1, 2, 3, 4]  # when the recorder got them
    for cycle, (_, image) in enumerate(read, 1):
        got = image.data.view("<f4").reshape(16, 16)
        assert np.array_equal(got.view("u4")[~np.isnan(got)], expected(cycle).view("u4")[~np.isnan(expected(cycle))])
        assert np.array_equal(np.isnan(got), np.isnan(expected(cycle)))
        assert reader.time_ns(image.header) == OFFSET_NS + 10 * cycle + SET_NS * (cycle > 2)


def test_bag_has_the_topics_of_skin_ros2(bag: Path) -> None:
    with AnyReader([bag]) as found:
        counts = {topic: about.msgcount for topic, about in found.topics.items()}
    every = ("image", "heat_map", "points", "contacts", "contact_markers", "key")
    assert counts == {f"/small/{name}": COUNT for name in every} | {"/small/wrench": COUNT - 1, "/diagnostics": 1}
    assert (bag / "metadata.yaml").is_file()


def test_the_key_joins_stamps_with_the_cycles_of_the_export(bag: Path) -> None:
    with AnyReader([bag]) as found:
        keys = [
            (reader.time_ns(told.header), told.status[0].name, {each.key: each.value for each in told.status[0].values})
            for each, _, content in found.messages()
            if each.topic == "/small/key"
            for told in [found.deserialize(content, each.msgtype)]
        ]
    assert keys == [
        (OFFSET_NS + 10 * cycle + SET_NS * (cycle > 2), "image", {"cycle": str(cycle)}) for cycle in range(1, COUNT + 1)
    ]


def test_the_code_of_the_page_reads_a_bag(bag: Path) -> None:
    code = block("docs/integrations.md", "AnyReader(")
    shapes = []
    names = {"on_image": lambda image: shapes.append((image.height, image.width))}
    exec(code.replace("run-bag", str(bag)).replace("/skin/", "/small/"), names)  # noqa: S102 - our own page
    assert shapes == [(16, 16)] * COUNT


def test_other_libraries_read_the_mcap(bag: Path) -> None:
    read = {}
    with (bag / "bag.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            read[channel.topic, message.log_time] = schema, message.data
    schema, content = read["/small/image", 3]
    image = reader.Image.deserialize(content)
    assert (schema.name, image.encoding, image.header.frame_id) == ("sensor_msgs/msg/Image", "32FC1", "small")
    assert np.array(image.data, np.uint8).tobytes() == pixels(3).tobytes()
    _, content = read["/small/contacts", 2]
    assert reader.PointCloud2.deserialize(content).width == 1


def test_a_bag_that_is_there_already_is_not_touched(run: Path, bag: Path) -> None:
    with pytest.raises(InputError, match="is there already"):
        export(run, to="ros2", out=bag)
