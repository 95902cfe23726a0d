"""A small skin with its gateway, all nodes running."""

import pytest

from dbc.contract import Contract
from tests.gateway.world import World, small_contract


@pytest.fixture(scope="session")
def small() -> Contract:
    return small_contract()


@pytest.fixture
def world(small: Contract) -> World:
    """Return a skin all of whose blocks are valid."""
    built = World(small)
    built.until_whole(2.0)
    return built
