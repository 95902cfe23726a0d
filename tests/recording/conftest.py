"""The small skin of the tests of ``rebuild``, its frames, and links that bring them."""

from pathlib import Path

import numpy as np
import pytest

from bus.link import State
from bus.messages import to_logged_frames
from dbc.contract import Contract
from dbc.frame import Frames, frames
from tests.rebuild.conftest import contract, force_n, layout_file, messages, sums

__all__ = ["contract", "force_n", "layout_file", "sums"]

#: Wall clock minus CLOCK_MONOTONIC in the tests.
OFFSET_NS = 1_699_999_000_000_000_000


class FakeLink:
    """A link that brings what is put into `coming`."""

    def __init__(self) -> None:
        self.coming: list[Frames] = []
        self.state = State.ACTIVE
        self.dropped = 0
        self.sent: list[Frames] = []

    def fileno(self) -> int:
        raise AssertionError("a recorder does not wait for frames")

    def receive(self) -> Frames:
        return self.coming.pop(0) if self.coming else frames(0)

    def send(self, burst: Frames) -> int:
        raise AssertionError("a recorder sends nothing")

    def close(self) -> None:
        """Nothing to leave."""


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
