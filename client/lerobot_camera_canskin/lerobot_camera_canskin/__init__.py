"""A canskin robot skin as a camera of LeRobot, which finds this package by its name."""

from lerobot_camera_canskin.canskin_camera import CanskinCamera
from lerobot_camera_canskin.config_canskin_camera import CanskinCameraConfig
from lerobot_camera_canskin.window import TouchWindow, features, forces

__all__ = ["CanskinCamera", "CanskinCameraConfig", "TouchWindow", "features", "forces"]
