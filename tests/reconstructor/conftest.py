"""A golf ball pressed into the skin and slid over it, in closed form."""

from typing import NamedTuple

import numpy as np
import pytest

from skin.layout import load_layout
from skin.measurement import Sbhe

PITCH_M = 0.004
BALL_RADIUS_M = 0.02133 + 0.002
FORCE_MAX_N = 0.02
NOISE_N = 0.001


class Scene(NamedTuple):
    """True forces, noisy taxels, both (frames, 64, 64) in newtons, and their sums (frames, m)."""

    true: np.ndarray
    sensor: np.ndarray
    sums: np.ndarray


def ball(x_m: float, y_m: float, depth_m: float) -> np.ndarray:
    """Force of every taxel under a golf ball; its compression in metres on springs of 1 N/m."""
    place = (np.arange(64) - 31.5) * PITCH_M
    distance_squared = (place[None, :] - x_m) ** 2 + (place[:, None] - y_m) ** 2
    height = np.sqrt(np.maximum(BALL_RADIUS_M**2 - distance_squared, 0)) - BALL_RADIUS_M
    return np.maximum(0, depth_m + height)


def sense(phi: Sbhe, true: np.ndarray, seed: int = 0) -> Scene:
    noise = np.random.default_rng(seed).normal(0, NOISE_N, true.shape)
    sensor = np.clip(true + noise, 0, FORCE_MAX_N).astype(np.float32)
    sums = np.asarray(phi.forward(sensor.reshape(len(true), -1)), np.float32)
    return Scene(true, sensor, sums)


def psnr_db(images: np.ndarray, true: np.ndarray) -> np.ndarray:
    """PSNR of every frame against 0.02 N (section V of the paper)."""
    return 10 * np.log10(FORCE_MAX_N**2 / np.mean((images - true) ** 2, axis=(1, 2)))


@pytest.fixture(scope="session")
def phi() -> Sbhe:
    return load_layout().phi()


@pytest.fixture(scope="session")
def golf(phi: Sbhe) -> Scene:
    """20 frames of pressing and 40 of sliding at 0.45 mm a frame: 45 mm/s at 100 Hz."""
    press = [ball(0.06, 0.06, 0.01 * k / 20) for k in range(20)]
    slide = [ball(0.06 - 0.0002 * k, 0.06 - 0.0004 * k, 0.01) for k in range(40)]
    return sense(phi, np.stack(press + slide))
