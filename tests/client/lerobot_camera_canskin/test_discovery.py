"""LeRobot finds the package by its name, and its command line knows the camera."""

import subprocess
import sys

import pytest

pytest.importorskip("lerobot", reason="NOT TESTED: discovery by LeRobot, for want of lerobot")

# A fresh interpreter: in this one, other tests have imported the package.
FIND = """
import sys
from dataclasses import dataclass

import draccus

from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import RobotConfig
from lerobot.utils.import_utils import register_third_party_plugins

assert "lerobot_camera_canskin" not in sys.modules
register_third_party_plugins()


@RobotConfig.register_subclass("hand")
@dataclass(kw_only=True)
class HandConfig(RobotConfig):
    cameras: dict[str, CameraConfig]


@dataclass
class Command:
    robot: RobotConfig


skin = "{skin: {type: canskin, endpoint: tcp/10.0.0.1:7447, window: 4, height: 256, width: 64, fps: 30}}"
command = draccus.parse(Command, args=["--robot.type=hand", f"--robot.cameras={skin}"])
camera = make_cameras_from_configs(command.robot.cameras)["skin"]
print(type(camera).__name__, camera.config.endpoint, camera.config.window, camera.height, camera.width, camera.fps)
"""


def test_lerobots_command_line_knows_the_skin_once_it_is_installed() -> None:
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", FIND], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1:] == ["CanskinCamera tcp/10.0.0.1:7447 4 256 64 30"], done.stderr
