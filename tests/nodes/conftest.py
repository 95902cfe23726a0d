"""A segment of nodes without a bus."""

from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import pytest

from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.segment import Segment
from nodes.synchronous_segment import SynchronousSegment
from skin.layout import load_layout
from skin.sources import Frame


class ArrayLink:
    """Keeps what nodes send, and echoes it as a bus without traffic would.

    What is tested here is what nodes make of frames, not a bus.
    """

    def __init__(self) -> None:
        self.sent: list[Frames] = []
        self.waiting: list[Frames] = []
        #: Frames that a send finds room for.
        self.room = 1 << 30

    def receive(self) -> Frames:
        arrived = np.concatenate(self.waiting) if self.waiting else frames(0)
        self.waiting.clear()
        return arrived

    def send(self, burst: Frames) -> int:
        taken = burst[: self.room].copy()
        self.sent.append(taken)
        echo = taken.copy()
        echo["flags"] |= ECHO
        self.waiting.append(echo)
        return len(taken)

    def take_sent(self) -> Frames:
        out = np.concatenate(self.sent) if self.sent else frames(0)
        self.sent.clear()
        return out


class Still:
    """A source with the same touch for ever."""

    has_noise = True

    def __init__(self, contract: Contract) -> None:
        taxels = contract.layout.taxels
        random = np.random.default_rng(1)
        self.force_n = random.uniform(0, taxels.force_max_n, (taxels.rows, taxels.columns)).astype(np.float32)

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
    return new_segment(contract, link, {1, 2, 3, 4})


def new_segment(
    contract: Contract,
    link: ArrayLink,
    node_ids: Collection[int],
    *,
    sampler: Sampler | None = None,
    complain: Callable[[str], None] = lambda _: None,
    store: Path | None = None,
) -> Segment:
    """Return nodes of bus0, booted."""
    if sampler is None:
        sampler = Sampler(contract.phi, Still(contract), Electronics(contract.layout.taxels, noise_n=0.0))
    built = SynchronousSegment(contract, 0, node_ids, link.send, sampler, complain=complain, store=store)
    built.boot(0.0)
    return built
