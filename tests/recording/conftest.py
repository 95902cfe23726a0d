"""The small skin of `tests.recording.helpers`, a touch that moves over it, and what its buses carry."""

from pathlib import Path

import numpy as np
import pytest

from bus.messages import to_logged_frames
from dbc.contract import Contract
from dbc.frame import Frames
from nodes.electronics import Electronics
from tests.layouts import layout_toml, small_layout
from tests.recording.helpers import CYCLES, OFFSET_NS, SMALL, FakeLink, messages, write_run


@pytest.fixture(scope="session")
def contract() -> Contract:
    return Contract.from_layout(small_layout(16, 16, **SMALL))


@pytest.fixture
def layout_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(layout_toml(16, 16, **SMALL))
    return path


@pytest.fixture(scope="session")
def force_n() -> np.ndarray:
    """A bump of 10 mN that wanders, shape (cycles, 16, 16)."""
    k, i, j = np.indices((CYCLES, 16, 16))
    return (0.01 * np.exp(-((i - 6 - k / 5) ** 2 + (j - 8) ** 2) / 6)).astype(np.float32)


@pytest.fixture(scope="session")
def sums(contract: Contract, force_n: np.ndarray) -> np.ndarray:
    """What the nodes measure, counts, shape (cycles, m)."""
    electronics = Electronics(contract.layout.taxels, noise_n=0.0)
    return np.stack([contract.phi.forward(electronics.read(each)) for each in force_n]).astype(np.int32)


@pytest.fixture(scope="session")
def bus_frames(contract: Contract, sums: np.ndarray) -> dict[int, Frames]:
    """The frames of each bus of the small skin, in the order of time, on CLOCK_MONOTONIC."""
    sent = messages(contract, sums)
    found = {}
    for number, bus in enumerate(contract.layout.bus):
        found[number] = to_logged_frames([each for each in sent if each.channel == bus.name])
        found[number]["time_ns"] -= OFFSET_NS
    return found


@pytest.fixture
def links(contract: Contract) -> dict[int, FakeLink]:
    return {number: FakeLink() for number in range(len(contract.layout.bus))}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


@pytest.fixture
def run(contract: Contract, out: Path) -> Path:
    """A recording of messages alone."""
    return write_run(out, contract)
