"""What the tests of several folders need."""

from pathlib import Path

import pytest

from tests.processes import free_endpoint


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def own_sockets(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the sockets of virtual buses in a folder of the test's own."""
    folder: Path = tmp_path_factory.mktemp("bus")
    folder.chmod(0o700)
    monkeypatch.setenv("SKIN_BUS_DIR", str(folder))
