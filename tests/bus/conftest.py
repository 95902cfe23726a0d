import pytest


@pytest.fixture(autouse=True)
def _own_sockets(own_sockets: None) -> None:
    """Every bus of these tests stands in a folder of its own."""
