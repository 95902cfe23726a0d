"""A segment of nodes without a bus."""

import shutil
from collections.abc import Iterator

import pytest

from dbc.contract import Contract
from nodes.electronics import Electronics
from nodes.firmware.library import Firmware
from nodes.sampler import CountSampler, Sampler
from nodes.segment import Segment
from tests.layouts import in_one_instant
from tests.nodes.helpers import ArrayLink, Still, new_sampler, new_segment
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
def segment(request: pytest.FixtureRequest, contract: Contract, link: ArrayLink) -> Segment:
    """Nodes 1 to 4 of bus0 in Python, and boards in C in their place, booted."""
    if request.param == "python":
        return new_segment(contract, link, {1, 2, 3, 4})
    if shutil.which("cc") is None:
        pytest.skip("NOT TESTED: no C compiler")
    boards = Firmware(contract, contract.on_bus(0)[:4]).boards(0)
    sampler = CountSampler(contract.phi, Still(contract), Electronics(contract.layout.taxels, noise_n=0.0))
    built = Segment(contract, 0, boards, sampler, link.send, complain=lambda _: None)
    built.boot(0.0)
    return built


@pytest.fixture
def bus(contract: Contract) -> Iterator[Bus]:
    """Stepped nodes 1 to 4 of bus0 of a module's own contract; none complains."""
    made = Bus(contract)
    yield made
    assert not made.complaints
