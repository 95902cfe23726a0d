"""``skin commission`` on a bus."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.layouts import buses, layout_toml
from tests.processes import PATIENCE_S, Processes


@pytest.mark.slow
def test_boards_without_node_ids_are_commissioned_and_store_them(tmp_path: Path) -> None:
    layout = tmp_path / "palm.toml"
    layout.write_text(layout_toml(8, 8, bus=buses(2)), encoding="utf-8")
    palm = ["--layout", str(layout)]
    with Processes(tmp_path) as processes, pytest.MonkeyPatch.context() as patch:
        patch.setenv("SKIN_BUS_DIR", str(tmp_path))
        processes.skin("bus", "bus", "bus0")
        processes.await_words("bus", "ready")
        processes.skin("nodes", "nodes", *palm, "--unnumbered", "--store", str(tmp_path / "flash"), "--no-fabric")
        processes.await_words("nodes", "nodes")
        command = [sys.executable, "-m", "skin", "commission", *palm, "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (bus,) = json.loads(done.stdout)
    assert [(each["node_id"], each["complete"]) for each in bus["boards"]] == [(1, True), (2, True)]
    assert "bus0, node 2: complete" in done.stderr
    kept = [json.loads((tmp_path / "flash" / f"bus0-{node_id}.json").read_text()) for node_id in (1, 2)]
    assert [each["node_id"] for each in kept] == [1, 2]
