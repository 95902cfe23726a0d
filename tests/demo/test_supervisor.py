"""Processes of a run: a wrong input, a failure, and the end."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from canskin.errors import InputError, RunError
from demo.supervisor import Supervisor
from tests.processes import PATIENCE_S


@pytest.fixture
def supervisor(tmp_path: Path) -> Supervisor:
    return Supervisor(tmp_path)


def until(holds: Callable[[], object]) -> None:
    for _ in range(round(PATIENCE_S / 0.01)):
        if holds():
            return
        time.sleep(0.01)
    pytest.fail("it did not happen")


@pytest.mark.heavy
def test_wrong_input_of_a_service_is_that_of_the_run(supervisor: Supervisor) -> None:
    child = supervisor.start("nodes", "nodes", "--layout", "missing.toml")
    child.process.wait(PATIENCE_S)
    with pytest.raises(InputError, match=r"^missing\.toml: cannot read the layout"):
        supervisor.look()


@pytest.mark.heavy
def test_service_that_the_run_needs_ends_it(supervisor: Supervisor) -> None:
    child = supervisor.start("bus", "bus", "only_for_this_test")
    until(lambda: "ready" in child.log.read_text())
    child.process.kill()
    child.process.wait(PATIENCE_S)
    with pytest.raises(RunError, match=r"bus ended \(status -9\)"):
        supervisor.look()


@pytest.mark.heavy
def test_restart_and_end(supervisor: Supervisor) -> None:
    child = supervisor.start("bus", "bus", "only_for_this_test", restart=True)
    first = child.process.pid
    until(lambda: "ready" in child.log.read_text())
    child.process.kill()
    child.process.wait(PATIENCE_S)
    events: list[str] = []
    until(lambda: events.extend(supervisor.look()) or child.process.pid != first)
    assert len(events) == 2
    until(lambda: child.log.read_text().count("ready") == 2)
    supervisor.stop()
    assert child.process.returncode == 0


def test_all_end_at_once(supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("demo.supervisor.HASTE_S", 0.0)
    children = [supervisor.start(f"bus{number}", "bus", f"at_once_{number}", restart=True) for number in range(2)]
    supervisor.stop_at_once()
    assert all(child.process.returncode is not None for child in children)
    assert not any(child.restart for child in children)
