"""A golf ball in closed form, measurements of forces, graphs of taxels, and what refuses wrong input."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import strategies as st

from canskin.errors import InputError
from canskin.messages import Image, Measurement
from skin.layout import Layout, load_layout
from skin.phi import Sbhe
from skin.surface import grid_surface
from tests import messages as make

LAYOUT: Layout = load_layout()
NAN, INF = float("nan"), float("inf")
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


def measurement(cycle: int, force_n: np.ndarray, valid: np.ndarray | None = None) -> Measurement:
    phi = LAYOUT.phi()
    counts = np.round(force_n / LAYOUT.taxels.newton_per_count).astype(np.uint16)
    valid = np.ones(phi.blocks, np.uint8) if valid is None else valid.astype(np.uint8)
    sums = np.asarray(phi.forward(counts.reshape(-1)), "<i4") * phi.sums_of_blocks(valid != 0)
    return make.measurement(
        cycle,
        sampled_mono_ns=1000 * cycle,
        sums=sums.astype("<i4").tobytes(),
        valid=valid.tobytes(),
        fingerprint=phi.fingerprint,
    )


def pixels(image: Image) -> np.ndarray:
    """Return the forces of an image of the default skin, newtons."""
    return np.frombuffer(image.pixels, "<f4").reshape((LAYOUT.taxels.rows, LAYOUT.taxels.columns))


def spoilt(values: np.ndarray, value: float) -> np.ndarray:
    made = np.array(values)
    made.flat[3] = value
    return made


def one_line(call: Callable[[], Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        call()
    assert "\n" not in str(caught.value)


@st.composite
def graphs(draw: st.DrawFn, taxels: int) -> np.ndarray:
    """Draw neighbours: some of a lattice, whose taxels have any numbers, and some at random."""
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    rows = draw(st.sampled_from([1, 2, 7]))
    lattice = grid_surface(rows, -(-taxels // rows), 1.0, np.zeros(0, np.intp)).edges
    lattice = lattice[(lattice < taxels).all(axis=1)]
    more = rng.integers(0, taxels, (draw(st.integers(0, taxels)), 2))
    both_kinds = np.concatenate((lattice, more[more[:, 0] != more[:, 1]]))
    kept = both_kinds[rng.random(len(both_kinds)) >= draw(st.sampled_from([0.0, 0.05]))]
    named = rng.permutation(taxels) if draw(st.booleans()) else np.arange(taxels)
    return np.unique(np.sort(named[kept], axis=1), axis=0)
