"""The code of the page of integrations for a node of ROS."""

import numpy as np

from tests.documents import block
from tests.health.helpers import Messages
from views.ros2.content import force_image, header


def test_a_node_of_ros_reads_an_image(messages: Messages) -> None:
    forces_n = messages.grid()
    forces_n[0, :3] = np.nan
    names: dict = {}
    exec(block("docs/integrations.md", "def on_image"), names)  # noqa: S102 - our own page
    assert names["on_image"](force_image(header(0, "palm"), forces_n)) == (np.nansum(forces_n), 3)
