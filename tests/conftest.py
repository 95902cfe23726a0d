"""What the tests of several folders need."""

from pathlib import Path

import pytest
from xdist.scheduler import LoadFileScheduling

from tests.processes import free_endpoint

#: The folder whose tests compile most of the kernels.
KERNELS = "tests/reconstructor/"


class KernelsOnce(LoadFileScheduling):
    """Gives each worker a file after the other, and one worker all that compiles kernels: the others find them made."""

    def _split_scope(self, nodeid: str) -> str:
        return KERNELS if nodeid.startswith(KERNELS) else super()._split_scope(nodeid)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> KernelsOnce | None:
    return KernelsOnce(config, log) if config.getvalue("dist") == "loadfile" else None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the kernels."""
    items.sort(key=lambda item: not item.nodeid.startswith(KERNELS))


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def own_sockets(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the sockets of virtual buses in a folder of the test's own."""
    folder: Path = tmp_path_factory.mktemp("bus")
    folder.chmod(0o700)
    monkeypatch.setenv("SKIN_BUS_DIR", str(folder))
