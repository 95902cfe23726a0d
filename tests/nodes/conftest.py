"""A segment of nodes without a bus."""

from collections.abc import Iterator

import pytest

from dbc.contract import Contract
from nodes.sampler import Sampler
from nodes.segment import Segment
from tests.layouts import in_one_instant
from tests.nodes.helpers import ArrayLink, new_sampler, new_segment
from tests.nodes.stepped_bus import Bus


@pytest.fixture(scope="session")
def contract() -> Contract:
    return Contract.from_layout(in_one_instant())


@pytest.fixture
def link() -> ArrayLink:
    return ArrayLink()


@pytest.fixture
def sampler(contract: Contract) -> Sampler:
    return new_sampler(contract)


@pytest.fixture
def segment(contract: Contract, link: ArrayLink, sampler: Sampler) -> Segment:
    """Nodes 1 to 4 of bus0, booted."""
    return new_segment(contract, link, {1, 2, 3, 4}, sampler=sampler)


@pytest.fixture
def bus(contract: Contract) -> Iterator[Bus]:
    """Stepped nodes 1 to 4 of bus0 of a module's own contract; none complains."""
    made = Bus(contract)
    yield made
    assert not made.complaints
