"""Messages of a small skin, and a hub to send them through."""

from collections.abc import Iterator

import pytest

from canskin.fabric import Fabric
from tests.health.helpers import Messages, palm_layout


@pytest.fixture
def messages(request: pytest.FixtureRequest) -> Messages:
    """Messages of the small skin, with the parameter's tables in its layout."""
    return Messages(palm_layout(**getattr(request, "param", {})))


@pytest.fixture
def hub(endpoint: str, messages: Messages) -> Iterator[Fabric]:
    fabric = Fabric(messages.layout.name, "gateway", endpoint, hub=True)
    yield fabric
    fabric.close()
