"""``skin node check`` on a bus."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.processes import PATIENCE_S, Processes


@pytest.mark.slow
def test_boards_on_a_bus_are_checked(tmp_path: Path) -> None:
    with Processes(tmp_path) as processes, pytest.MonkeyPatch.context() as patch:
        patch.setenv("SKIN_BUS_DIR", str(tmp_path))
        processes.skin("bus", "bus", "bus0")
        processes.await_words("bus", "ready")
        processes.skin("nodes", "nodes", "--only", "bus0:1-2", "--no-fabric")
        processes.await_words("nodes", "nodes")

        def check(node_id: int) -> "subprocess.CompletedProcess[str]":
            command = [sys.executable, "-m", "skin", "node", "check", "--bus", "bus0", "--node", str(node_id), "--json"]
            return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)

        good, nobody = check(2), check(9)
        assert (good.returncode, nobody.returncode) == (0, 1)
        report = json.loads(good.stdout)
        assert (report["bus"], report["node_id"], report["differences"]) == ("bus0", 2, [])
        assert report["frames"] >= report["cycles"] == 12
        assert "no answer" in json.loads(nobody.stdout)["differences"][0]
