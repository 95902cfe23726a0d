"""What the tests of several folders need, and who runs which on several cores."""

import gc
import math
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
from hypothesis.internal.conjecture import providers
from xdist.scheduler import LoadFileScheduling

from canskin import session
from canskin.keys import UNIX
from tests.processes import PATIENCE_S, Verb, free_endpoint

# A peer of the ROS 2 tests imports GitPython, which fails without a program that no test runs.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

#: The folder whose tests compile most of the kernels.
KERNELS: Final = "tests/reconstructor/"
#: Whole chains: their services keep time, so they run one after the other and before other tests.
CHAINS: Final = (
    *("tests/system/", "tests/views/page/test_browser.py"),
    "tests/views/metrics/test_prometheus.py",
    "tests/deploy/test_units.py",  # at the end: its services take over the kernels that others have made
)
#: Other tests get a quarter of a core that a chain wants, too.
NICE: Final = 5


# The same examples in every run: hypothesis also draws from the constants of the modules that are imported so far. They
# are others in a run of one file, on another number of cores, and after a change of any module.
providers._get_local_constants = lambda: providers._local_constants


class ChainsInTurn(LoadFileScheduling):
    """Gives each worker a file after the other.

    The first worker compiles the kernels, which the others find made. Then it runs the chains, one after the other.
    """

    def _split_scope(self, nodeid: str) -> str:
        return KERNELS if _turn(nodeid) < OTHERS else super()._split_scope(nodeid)


#: The turn of all other files.
OTHERS: Final = 1 + len(CHAINS)


def _turn(nodeid: str) -> int:
    return next((turn for turn, begin in enumerate((KERNELS, *CHAINS)) if nodeid.startswith(begin)), OTHERS)


def pytest_configure() -> None:
    """Let SIGINT end the programs of the tests, also where a shell runs the tests in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ChainsInTurn | None:
    return ChainsInTurn(config, log) if config.getvalue("dist") == "loadfile" else None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the kernels, go on with the chains."""
    items.sort(key=lambda item: _turn(item.nodeid))


def pytest_collection_finish() -> None:
    """Take what was collected, which stays to the end, out of the sight of the garbage collector."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """On several cores, make way for the first worker."""
    if hasattr(item.config, "workerinput") and _turn(item.nodeid) == OTHERS:
        os.nice(max(NICE - os.nice(0), 0))


@pytest.fixture(autouse=True, scope="session")
def ordinary_scheduling() -> Iterator[None]:
    """Refuse real time to services that run inside a test: the test's process and its children would keep it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "sched_setscheduler", _refuse)
        yield


def _refuse(*_: object) -> None:
    raise PermissionError


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def skin(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Verb:
    """Run ``skin`` with arguments in this process; return exit code, output and errors."""
    from shell.command import main

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["skin", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return int(ended.value.code or 0), *capsys.readouterr()

    return run


@pytest.fixture
def one_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a search for services end with the first answer of the hub, which may take its time."""
    monkeypatch.setattr(session, "LOOK_S", math.inf)
    monkeypatch.setattr(session, "TRY_S", PATIENCE_S)


@pytest.fixture
def own_sockets(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the sockets of virtual buses, and that of the hub, in a folder of the test's own."""
    folder: Path = tmp_path_factory.mktemp("bus")
    folder.chmod(0o700)
    monkeypatch.setenv("SKIN_BUS_DIR", str(folder))
    monkeypatch.setattr("shell.skin_options.DEFAULT_ENDPOINT", f"{UNIX}/{folder / 'hub'}")
