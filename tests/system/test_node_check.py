"""``skin node check`` and ``skin node update`` on a bus."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.commissioning.wiring_errors import stroke
from tests.layouts import buses, layout_toml, small_layout
from tests.nodes.firmware.twins import needs_compiler
from tests.processes import Processes
from tests.system.conftest import Command


@pytest.mark.slow
def test_boards_on_a_bus_are_checked(command: Command, slow_layout: Path, tmp_path: Path) -> None:
    slow = ["--layout", str(slow_layout)]
    with Processes(tmp_path) as processes:
        processes.skin("bus", "bus", "bus0")
        processes.await_words("bus", "ready")
        processes.skin("nodes", "nodes", *slow, "--only", "bus0:1-2", "--no-fabric")
        processes.await_words("nodes", "nodes")

        good, nobody = (command("node", "check", *slow, "--bus", "bus0", "--node", each, "--json") for each in "29")
        assert (good.returncode, nobody.returncode) == (0, 1)
        report = json.loads(good.stdout)
        assert (report["bus"], report["node_id"], report["differences"]) == ("bus0", 2, [])
        assert report["frames"] >= report["cycles"] >= 16  # where SYNC came late a pattern is shown again
        assert "no answer" in json.loads(nobody.stdout)["differences"][0]


@needs_compiler
@pytest.mark.slow
def test_boards_in_c_get_a_program_over_the_bus_and_keep_it(command: Command, tmp_path: Path) -> None:
    (tmp_path / "main.bin").write_bytes(bytes(range(256)) * 8)
    program, store = str(tmp_path / "new.bin"), str(tmp_path / "flash")
    (tmp_path / "palm.toml").write_text(layout_toml(8, 16, bus=buses(4)), encoding="utf-8")
    palm = ["--layout", str(tmp_path / "palm.toml")]
    with Processes(tmp_path) as processes:
        exported = command(
            "contract", *palm[1:], "--program", str(tmp_path / "main.bin"), "--release", "1.1", "--out", program
        )
        assert "2080 bytes" in exported.stdout, exported.stderr
        processes.skin("bus", "bus", "bus0")
        processes.await_words("bus", "ready")
        boards = ["nodes", "--firmware", "--only", "bus0:1-2", "--no-fabric", "--store", store, *palm]
        processes.skin("nodes", *boards)
        processes.await_words("nodes", "nodes")
        one = command("node", "update", program, "--bus", "bus0", "--node", "2", "--json", *palm)
        assert one.returncode == 0, one.stderr
        (board,) = json.loads(one.stdout)["boards"]
        assert (board["node"], board["result"], board["before"] == board["after"]) == (2, "started", False)
        again = command("node", "update", program, "--bus", "bus0", "--all", *palm)
        assert again.returncode == 1  # the other boards of the bus are not there
        assert [line.split()[1] for line in again.stdout.splitlines() if "run" in line][:1] == ["2"]
        assert "2 of 4 boards run version 1.1" in again.stdout
        assert "no answer to object 1F56h:1" in again.stdout
        processes.stop("nodes")
        processes.skin("nodes", *boards)
        processes.await_words("nodes", "nodes")
        version = command("node", "get", "100Ah", "--bus", "bus0", "--node", "1", "--json", *palm)
        assert json.loads(version.stdout)[0]["value"] == "1.1"


@pytest.mark.slow
def test_swapped_taxels_are_named_while_a_finger_strokes_the_skin(command: Command, tmp_path: Path) -> None:
    tables = {"bus": buses(8), "sync": {"rate_hz": 40}, "measurement": {"block_size": 8}}
    (tmp_path / "palm.toml").write_text(layout_toml(**tables), encoding="utf-8")
    layout = small_layout(**tables)
    _, force_n = stroke(layout, layout.phi(), np.random.default_rng(0), 8)
    untouched = np.zeros((40, 8, 8), np.float32)  # for ten slow readings
    np.save(tmp_path / "stroke.npy", np.concatenate((untouched, force_n.reshape(-1, 8, 8))))
    with Processes(tmp_path) as processes:
        processes.skin("bus", "bus", "bus0")
        processes.await_words("bus", "ready")
        palm = ["--layout", str(tmp_path / "palm.toml")]
        touch = ["--input", str(tmp_path / "stroke.npy"), "--defect", "swapped=0.02"]
        processes.skin("nodes", "nodes", *palm, *touch, "--no-fabric")
        processes.await_words("nodes", "nodes")
        done = command("node", "check", *palm, "--live", "27", "--rest", "0.7", "--json")
    assert done.returncode == 1, done.stderr
    assert [each["kind"] for each in json.loads(done.stdout)] == ["swapped", "swapped"]
    assert "readings a second" in done.stderr
