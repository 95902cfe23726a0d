"""A segment of nodes without a bus."""

import shutil
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
def in_python(contract: Contract, link: ArrayLink, sampler: Sampler) -> Segment:
    """Nodes 1 to 4 of bus0 in Python, booted."""
    return new_segment(contract, link, {1, 2, 3, 4}, sampler=sampler)


@pytest.fixture(params=["python", "c"])
def in_c(request: pytest.FixtureRequest) -> bool:
    """Whether boards in C take the place of nodes in Python."""
    if request.param == "c" and shutil.which("cc") is None:
        pytest.skip("NOT TESTED: no C compiler")
    return bool(request.param == "c")


@pytest.fixture
def segment(in_c: bool, contract: Contract, link: ArrayLink) -> Segment:
    """Nodes 1 to 4 of bus0 in Python, and boards in C in their place, booted."""
    return new_segment(contract, link, {1, 2, 3, 4}, in_c=in_c)


@pytest.fixture
def bus(contract: Contract) -> Iterator[Bus]:
    """Stepped nodes 1 to 4 of bus0 of a module's own contract; none complains."""
    made = Bus(contract)
    yield made
    assert not made.complaints
