"""Messages of a small skin, and a hub to send them through."""

from collections.abc import Iterator

import pytest

from canskin.fabric import Fabric
from tests.health.helpers import Messages


@pytest.fixture
def messages() -> Messages:
    return Messages()


@pytest.fixture
def hub(endpoint: str, messages: Messages) -> Iterator[Fabric]:
    fabric = Fabric(messages.layout.name, "gateway", endpoint, hub=True)
    yield fabric
    fabric.close()
