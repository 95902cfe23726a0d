"""A small skin with its gateway, all nodes running."""

import pytest

from dbc.contract import Contract
from tests.gateway.boards import BoardWorld, small_stepped
from tests.layouts import small_contract
from tests.world import World


@pytest.fixture(scope="session")
def small() -> Contract:
    return small_contract()


@pytest.fixture
def world(small: Contract) -> World:
    """Return a skin all of whose blocks are valid."""
    built = World(small)
    built.until_whole(2.0)
    return built


@pytest.fixture(scope="session")
def stepped() -> Contract:
    return small_stepped()


@pytest.fixture
def boards(stepped: Contract) -> BoardWorld:
    """Return a skin of stepped boards all of whose blocks are valid, the second touched."""
    built = BoardWorld(stepped)
    built.touch(1)
    built.until_whole(1.0)
    return built
