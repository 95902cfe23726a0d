"""The code of docs/ros2.md."""

import queue

import numpy as np

from canskin.fabric import Fabric
from canskin.messages import IMAGE
from skin.wall_times import CLOCKS, Clocks
from tests.documents import block
from tests.health.helpers import Messages
from tests.views.ros2.reader import PATIENCE_S, publish
from views.ros2.bridge import Bridge
from views.ros2.node import RosNode
from views.ros2.topics import FORCE_IMAGE

CODE = block("docs/ros2.md", "def on_image") + "\n" + block("docs/ros2.md", "RosReader(")


def test_a_reader_without_ros_gets_the_images(hub: Fabric, endpoint: str, messages: Messages) -> None:
    fabric = Fabric("palm", "ros2", endpoint)
    node = RosNode(endpoint, domain=0, namespace="/skin", name="canskin")
    bridge = Bridge(messages.layout, fabric, node, "palm")
    came: queue.Queue[tuple[float, int]] = queue.Queue()
    code = CODE.replace("tcp/127.0.0.1:7447", endpoint).replace(", on_image)", ", note)")
    names: dict = {"note": lambda message: came.put(names["on_image"](message))}
    exec(code, names)  # noqa: S102 - our own page
    while not bridge._publishers[FORCE_IMAGE].has_readers:
        bridge.turn(0.01)
    publish(hub, CLOCKS, Clocks(sampled_mono_ns=0, wall_offset_ns=0))
    bridge.turn(PATIENCE_S)
    publish(hub, IMAGE, messages.image(invalid=(3,)))
    bridge.turn(PATIENCE_S)
    force_n, unknown = came.get(timeout=PATIENCE_S)
    valid = messages.layout.phi().block_of_taxel.reshape(16, 16) != 3
    assert force_n == np.nansum(np.where(valid, messages.grid(), np.nan))
    assert unknown == 32
    for each in (names["reader"], node, fabric):
        each.close()
