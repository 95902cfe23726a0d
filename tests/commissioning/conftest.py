"""Small skins to bring up."""

import pytest

from dbc.contract import Contract
from tests.gateway.boards import small_stepped
from tests.layouts import small_contract


@pytest.fixture(scope="session")
def small() -> Contract:
    return small_contract()


@pytest.fixture(scope="session")
def stepped() -> Contract:
    return small_stepped()
