"""``skin node check`` on a bus."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.gateway.wiring_errors import stroke
from tests.layouts import buses, layout_toml, small_layout
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
        assert report["frames"] >= report["cycles"] == 16
        assert "no answer" in json.loads(nobody.stdout)["differences"][0]


@pytest.mark.slow
def test_swapped_taxels_are_named_while_a_finger_strokes_the_skin(tmp_path: Path) -> None:
    tables = {"bus": buses(4), "sync": {"rate_hz": 20}, "measurement": {"block_size": 16}}
    (tmp_path / "palm.toml").write_text(layout_toml(**tables), encoding="utf-8")
    layout = small_layout(**tables)
    _, force_n = stroke(layout, layout.phi(), np.random.default_rng(0), 8)
    np.save(tmp_path / "stroke.npy", force_n.reshape(-1, 8, 8))
    with Processes(tmp_path) as processes, pytest.MonkeyPatch.context() as patch:
        patch.setenv("SKIN_BUS_DIR", str(tmp_path))
        processes.skin("bus", "bus", "bus0")
        processes.await_words("bus", "ready")
        palm = ["--layout", str(tmp_path / "palm.toml")]
        touch = ["--input", str(tmp_path / "stroke.npy"), "--defect", "swapped=0.02"]
        processes.skin("nodes", "nodes", *palm, *touch, "--no-fabric")
        processes.await_words("nodes", "nodes")
        command = [sys.executable, "-m", "skin", "node", "check", *palm, "--live", "36", "--rest", "0.7", "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 1, done.stderr
    assert [each["kind"] for each in json.loads(done.stdout)] == ["swapped", "swapped"]
    assert "readings a second" in done.stderr
