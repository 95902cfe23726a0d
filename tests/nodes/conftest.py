"""A segment of nodes on a link without a bus."""

import numpy as np
import pytest

from bus.link import State
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.segment import Segment
from skin.layout import load_layout
from skin.sources import Frame


class ArrayLink:
    """A link whose frames come from an array: what is tested here is what nodes make of frames, not a bus.

    Sent frames are kept, and echoed as a bus without traffic would.
    """

    dropped = 0
    state = State.ACTIVE

    def __init__(self) -> None:
        self.sent: list[Frames] = []
        self.waiting: list[Frames] = []

    def fileno(self) -> int:
        raise NotImplementedError

    def receive(self) -> Frames:
        arrived = np.concatenate(self.waiting) if self.waiting else frames(0)
        self.waiting.clear()
        return arrived

    def send(self, burst: Frames) -> int:
        self.sent.append(burst.copy())
        echo = burst.copy()
        echo["flags"] |= ECHO
        self.waiting.append(echo)
        return len(burst)

    def close(self) -> None:
        pass

    def take_sent(self) -> Frames:
        out = np.concatenate(self.sent) if self.sent else frames(0)
        self.sent.clear()
        return out


class Still:
    """A source with the same touch for ever."""

    has_noise = True

    def __init__(self) -> None:
        self.force_n = np.random.default_rng(1).uniform(0, 0.02, (64, 64)).astype(np.float32)

    def frame(self, step: int) -> Frame:
        return Frame(self.force_n, "")


@pytest.fixture(scope="session")
def contract() -> Contract:
    return Contract.from_layout(load_layout())


@pytest.fixture
def link() -> ArrayLink:
    return ArrayLink()


@pytest.fixture
def segment(contract: Contract, link: ArrayLink) -> Segment:
    """Nodes 1 to 4 of bus0, booted."""
    sampler = Sampler(contract.phi, Still(), Electronics(contract.layout.taxels, noise_n=0.0))
    built = Segment(contract, 0, {1, 2, 3, 4}, link, sampler)
    built.boot(0.0)
    return built
