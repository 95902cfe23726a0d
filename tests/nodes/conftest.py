"""A segment of nodes without a bus."""

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import pytest

from dbc.contract import Contract
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.segment import Segment
from nodes.virtual_boards import VirtualBoards
from skin.layout import load_layout
from tests.nodes.adaptive_bus import Bus
from tests.nodes.links import ArrayLink, Still


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


@pytest.fixture
def bus(contract: Contract) -> Iterator[Bus]:
    """Adaptive nodes 1 to 4 of bus0 of a module's own contract; none complains."""
    made = Bus(contract)
    yield made
    assert not made.complaints


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
    boards = VirtualBoards(contract, 0, node_ids, sampler, store=store)
    built = Segment(contract, 0, boards, sampler, link.send, complain=complain)
    built.boot(0.0)
    return built
