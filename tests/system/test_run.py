"""``skin run``: the services of a skin in one process, which its end, its errors and its watchdog are of."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from canskin.messages import SERVICES, ServiceStatus
from tests.processes import Processes
from tests.system.conftest import Chain, Command

ALL = ("gateway", "reconstructor", "classifier", "viewer")
#: `skin`, with a reconstructor that breaks at its third image.
BREAKS = """
import sys
from reconstructor.service import ReconstructorService
from shell.command import main
take = ReconstructorService.take
def breaks(self, measurement):
    take(self, measurement)
    assert self.images < 3
ReconstructorService.take = breaks
sys.argv[0] = "skin"
main()
"""


@pytest.mark.slow
def test_a_skin_in_one_process_gives_each_message_once_and_ends_in_order(chain: Chain) -> None:
    statuses: dict[str, ServiceStatus] = {}
    chain.fabric.subscribe(SERVICES, lambda status: statuses.update({status.service: status}))
    chain.start_bus()
    chain.start("nodes", "nodes")
    words = ("gateway", "+", "reconstruct", "+", "classify", "+", "view", "--port", "0")
    chain.start("run", "run", *words)
    chain.until_alive(*ALL, "nodes")
    chain.until("whole images", lambda: bool(chain.images) and min(chain.images[-1].valid) == 1)
    chain.until("20 labels", lambda: len(chain.labels) >= 20)
    chain.poll("a status of each", lambda: statuses.keys() >= set(ALL))
    assert len({status.instance for status in statuses.values()}) == len(statuses)
    process = chain.supervisor.children["run"].process
    process.send_signal(signal.SIGTERM)
    chain.until("all gone", lambda: chain.alive.isdisjoint(ALL))
    assert process.wait(60) == 0, chain.supervisor.children["run"].log.read_text()
    for made in ([each.number for each in chain.images], [each.number for each in chain.labels]):
        assert set(np.diff(made)) == {1}


@pytest.mark.slow
def test_a_service_that_breaks_ends_the_process_with_its_error(slow_layout: Path, tmp_path: Path) -> None:
    with Processes(tmp_path, XDG_RUNTIME_DIR=str(tmp_path)) as processes:
        processes.skin("bus", "bus", "--layout", str(slow_layout))
        processes.await_words("bus", "ready")
        processes.skin("nodes", "nodes", "--layout", str(slow_layout))
        words = ["run", "--layout", str(slow_layout), "gateway", "+", "reconstruct", "+", "view", "--port", "0"]
        places = {"SKIN_BUS_DIR": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path)}
        command = [sys.executable, "-c", BREAKS, *words]
        done = subprocess.run(command, env=os.environ | places, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, "AssertionError")
    assert "in breaks" in done.stderr


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("words", "means"),
    [
        ("gateway + gateway", "each of gateway, reconstruct, classify, view once, '+' between two, got 'gateway'"),
        ("gateway + record", "got 'record'"),
        ("+", "got '+'"),
        ("reconstruct --listen tcp/127.0.0.1:7447", "--listen: expected a gateway"),
        ("reconstruct + view --port many", "many"),
        ("reconstruct --gains absent.json --layout default", "absent.json"),
    ],
)
def test_wrong_words_are_one_line(words: str, means: str, command: Command) -> None:
    done = command("run", *words.split())
    assert done.returncode == 2
    assert means in done.stderr.splitlines()[-1]
