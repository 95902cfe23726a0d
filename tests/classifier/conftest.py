"""A small skin with two simple objects, so that nothing here needs the simulator."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from classifier.model import Model
from classifier.training import TrainingOptions, train
from skin.layout import Layout
from skin.phi import Sbhe
from tests.layouts import small_layout

SMALL: Final = {"measurement": {"sums": 512}, "sync": {"rate_hz": 20.0}}


class Touches(NamedTuple):
    force_n: npt.NDArray[np.float32]
    labels: npt.NDArray[np.str_]


def draw(count: int, seed: int, least_n: float = 0.004) -> Touches:
    """Return blunt "dome"s and flat "plate"s, anywhere on 32 x 32 taxels, `least_n` to 0.01 N deep."""
    rng = np.random.default_rng(seed)
    places = np.arange(32)
    force_n = np.empty((count, 32, 32), np.float32)
    labels = np.array([("dome", "plate")[index % 2] for index in range(count)], np.str_)
    for index in range(count):
        row, column = rng.uniform(7, 25, 2)
        away = np.hypot(places[:, None] - row, places - column)
        depth = rng.uniform(least_n, 0.01)
        profile = 1 - (away / 3) ** 2 if labels[index] == "dome" else np.where(away < 6.5, 1.0, 0.0)
        force_n[index] = depth * np.clip(profile, 0, 1)
    return Touches(force_n, labels)


@pytest.fixture(scope="session")
def layout() -> Layout:
    return small_layout(32, 32, **SMALL)


@pytest.fixture(scope="session")
def phi(layout: Layout) -> Sbhe:
    return layout.phi()


@pytest.fixture(scope="session")
def touches() -> Touches:
    return draw(240, seed=1)


@pytest.fixture(scope="session")
def unseen() -> Touches:
    return draw(200, seed=2)


@pytest.fixture(scope="session")
def model(layout: Layout, touches: Touches) -> Model:
    return train(*touches, layout, options=TrainingOptions(no_touches=3000))


@pytest.fixture(scope="session")
def raw_model(layout: Layout, touches: Touches) -> Model:
    """The paper's mode: raw sums."""
    return train(*touches, layout, options=TrainingOptions(features="sums", no_touches=500))
