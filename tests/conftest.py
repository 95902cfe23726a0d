"""What the tests of several folders need."""

import pytest

from tests.processes import free_endpoint


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()
