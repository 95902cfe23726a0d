"""Messages of a small skin."""

import pytest

from tests.health.helpers import Messages


@pytest.fixture
def messages() -> Messages:
    return Messages()
