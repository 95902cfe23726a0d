"""``skin plan``, ``skin load`` and ``skin layout`` as a person and as a program use them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

from dbc.contract import Contract
from skin.layout import load_layout, parse_layout
from tests.layouts import buses, layout_toml
from tests.processes import Verb

# The arguments stand where the command finds them, in sys.argv.


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """0.2 seconds of all four buses; TPDOs follow each other with the most stuff bits."""
    contract = Contract.from_layout(load_layout())
    path = tmp_path_factory.mktemp("logs") / "skin.log"
    random = np.random.default_rng(2)
    with can.Logger(path) as logger:
        for cycle in range(41):
            for bus in range(4):
                for place, frame in enumerate(contract.cycle(bus, cycle % 2)):
                    data = bytes((1 + cycle,)) + random.bytes(int(frame["length"]) - 1)
                    logger(
                        can.Message(
                            timestamp=1000 + 0.005 * cycle + 65e-6 + 135e-6 * place,
                            arbitration_id=int(frame["can_id"]),
                            is_extended_id=False,
                            data=data,
                            channel=f"vcan{bus}",
                        )
                    )
    return path


@pytest.mark.heavy
def test_json_plan_has_buses_and_wires(skin: Verb) -> None:
    status, out, said = skin("plan", "--json")
    document = json.loads(out)
    assert (status, said) == (0, "")
    assert document["fits"] is True
    bus = document["buses"][3]
    assert bus["name"] == "bus3"
    assert bus["max_rate_hz_random"] == pytest.approx(269.1, rel=0.01)
    assert bus["max_rate_hz_worst"] == pytest.approx(227.6, rel=0.01)
    assert bus["load_touched"] == pytest.approx(0.764, rel=0.01)
    assert bus["load_worst"] == pytest.approx(0.8791, rel=0.0005)
    assert [node["node_id"] for node in bus["node_plans"]] == list(range(1, 33))
    wires = document["wiring"]
    assert wires["longest_chain_m"] == pytest.approx(1.627, abs=0.001)
    assert wires["wires_m"] == pytest.approx(165.6, abs=0.1)
    assert wires["conversions_per_s"] == 32_000


@pytest.mark.heavy
def test_a_person_gets_a_table(skin: Verb) -> None:
    status, out, _ = skin("plan", "fd")
    assert status == 0
    assert "load, touched / worst" in out
    assert "183.8" in out
    assert "bus0: 1: " in out
    assert "longest chain of taxels 1.63 m, all chains 165.6 m, 12800 conversions a second on a node" in out


@pytest.mark.heavy
def test_a_layout_that_does_not_fit_ends_with_1_and_says_why(skin: Verb, tmp_path: Path) -> None:
    path = tmp_path / "fast.toml"
    path.write_text(layout_toml(64, 64, sync={"rate_hz": 150.0}, bus=buses(64, 64)))
    status, out, _ = skin("plan", path)
    assert status == 1
    assert "bits a second are missing" in " ".join(out.split())


def test_a_search_writes_the_layout(skin: Verb, tmp_path: Path) -> None:
    path = tmp_path / "palm.toml"
    status, out, said = skin("plan", "--taxels", 1024, "--rate", 100, "--buses", 1, "--out", path)
    assert (status, out) == (0, f"{path}\n")
    assert "at worst" in said
    assert "images, 256 sums: 4" in said
    assert "a scan of all taxels of 7 bits, filtered on the boards, fits these buses at" in said
    assert "longest chain of taxels" in said
    layout = parse_layout(path.read_bytes(), "palm")
    assert (layout.taxels.count, len(layout.bus), layout.sync.rate_hz) == (1024, 1, 100.0)
    assert (layout.samples_per_sync, layout.name) == (10, "palm")
    status, text, _ = skin("plan", path, "--quality", "--json")
    predicted, *others = json.loads(text)["quality"]
    assert [each["sums"] for each in others] == [64, 128, 512, 1024]
    assert f"images, 256 sums: {predicted['psnr_image_db']:.1f} dB" in said
    assert predicted["psnr_image_db"] > predicted["psnr_sensor_db"] + 10


def test_a_search_without_a_result_says_what_is_missing(skin: Verb) -> None:
    arguments = ("plan", "--taxels", 4096, "--rate", 100, "--buses", 1, "--can", "classic")
    status, out, said = skin(*arguments)
    assert (status, out) == (1, "")
    assert "bits a second" in said
    assert "node-IDs" in said
    assert "it fits at up to 46 Hz" in said
    status, out, _ = skin(*arguments, "--json")
    document = json.loads(out)
    assert (status, document["fits"], document["layout"]) == (1, False, None)
    assert "bits a second" in document["missing"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plan", "--taxels", "-5"], "expected 64 to 65536 taxels, got -5"),
        (["plan", "--taxels", "24x300"], "256 or less"),
        (["plan", "--taxels", "many"], "a number, ROWSxCOLUMNS, or a file of taxels"),
        (["plan", "--rate", "50"], "a search needs --taxels"),
        (["plan", "--jitter-s", "-1"], "--jitter-s needs a number from 0 to 1"),
        (["plan", "--jitter-s", "nan"], "--jitter-s needs a number from 0 to 1"),
        (["plan", "--errors-per-s", "inf"], "--errors-per-s needs a number from 0 to 20000"),
        (["plan", "--sdo-per-s", "1e6"], "--sdo-per-s needs a number from 0 to 20000"),
        (["plan", "palm.toml", "--taxels", "1024"], "takes no layout"),
        (["plan", "--timing", "--quality"], "got both"),
        (["plan", "--clock-hz", "8000000"], "are for --timing"),
        (["plan", "-c", "can0"], "--channel is for --timing"),
        (["load", "nowhere.log"], "no such log"),
        (["load", "--seconds", "0"], "--seconds needs a number above 0"),
        (["load", "--seconds", "inf"], "--seconds needs a number above 0"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(skin: Verb, arguments: list[str], said: str) -> None:
    status, out, words = skin(*arguments)
    assert (status, out) == (2, "")
    assert said in words
    assert words.count("\n") == 1


@pytest.mark.heavy
def test_load_of_a_log(skin: Verb, log: Path) -> None:
    status, out, _ = skin("load", log, "--json")
    loads = json.loads(out)["buses"]
    assert status == 0
    assert [each["name"] for each in loads] == ["bus0", "bus1", "bus2", "bus3"]
    for each in loads:
        assert each["load_exact"] == pytest.approx(0.7462, rel=0.003)  # random sums, no heartbeats
        assert each["load_worst"] == pytest.approx(0.877, rel=0.0005)
    table = skin("load", log)[1]
    assert "load planned, touched" in table
    assert "2A0h" in table


@pytest.mark.heavy
def test_check_of_a_log(skin: Verb, log: Path, tmp_path: Path) -> None:
    assert skin("load", log, "--check") == (0, "", "")
    lines = log.read_text().splitlines()
    broken = tmp_path / "broken.log"
    broken.write_text("\n".join(line for line in lines if " vcan2 187#" not in line) + "\n")
    assert skin("load", broken, "--check")[:2] == (1, "bus2: node 7: 20 TPDOs missing\n")
    status, out, _ = skin("load", broken, "--check", "--json")
    assert (status, json.loads(out)) == (1, {"differences": ["bus2: node 7: 20 TPDOs missing"]})
    status, out, _ = skin("load", broken, "--check", "-c", "vcan2", "-c", "vcan1", "-c", "none", "-c", "vcan3")
    assert (status, "bus0: node 7: 20 TPDOs missing" in out) == (1, True)


@pytest.mark.heavy
def test_a_log_of_another_layout_is_refused_or_noticed(skin: Verb, log: Path, tmp_path: Path) -> None:
    status, out, said = skin("load", log, "--layout", "one-bus-12bit", "-c", "vcan0")
    assert (status, said.count("Give the right one with --layout")) == (0, 1)
    fd = tmp_path / "fd.log"
    fd.write_text("(1.0) bus0 181##1" + "00" * 32 + "\n(1.1) bus0 182##1" + "00" * 32 + "\n")
    status, out, said = skin("load", fd)
    assert (status, out) == (2, "")
    assert "the layout has classic CAN there, but 2 of 2 frames are CAN FD" in said


@pytest.mark.heavy
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_waiting_for_a_bus_ends_with_a_signal(number: int, status: int, tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "skin", "load"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "SKIN_BUS_DIR": str(tmp_path)},
    ) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "load: waits for bus 'bus0'\n"
        process.send_signal(number)
        out, said = process.communicate(timeout=240)
    assert (process.returncode, out, said) == (status, "", "")


def test_layout_is_explained_and_drawn(skin: Verb, tmp_path: Path) -> None:
    (tmp_path / "mat.toml").write_text(layout_toml(10, 10, name="mat", measurement={"wiring": "board"}))
    code, shown, _ = skin("layout", "check", str(tmp_path / "mat.toml"), "--json")
    about = json.loads(shown)
    assert code == 0
    assert (about["taxels"], about["blocks"], about["taxels_of_a_block"], about["empty_places"]) == (100, 4, [25], 28)
    picture = tmp_path / "mat.png"
    code, shown, _ = skin("layout", "draw", str(tmp_path / "mat.toml"), "--out", str(picture))
    assert code == 0
    assert str(picture) in shown
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_new_layout_is_what_its_file_says(skin: Verb, tmp_path: Path) -> None:
    lines = [f"{0.004 * (taxel % 6):.3f},{0.004 * (taxel // 6):.3f},0,{taxel // 10}" for taxel in range(30)]
    (tmp_path / "pad.csv").write_text("x_m,y_m,z_m,board\n" + "\n".join(lines) + "\n")
    made = tmp_path / "strip.toml"
    code, shown, _ = skin("layout", "new", str(tmp_path / "pad.csv"), "--out", str(made))
    assert code == 0
    assert "strip" in shown
    layout = load_layout(made)
    assert (layout.name, layout.taxels.there, layout.blocks, layout.measurement.block_size) == ("strip", 30, 3, 16)
    assert (layout.measurement.sums, layout.sampling.rate_hz) == (48, 1000.0)
    code, _, said = skin("layout", "new", str(tmp_path / "pad.csv"), "--out", str(tmp_path / "pad.toml"))
    assert code == 0
    assert "measurement.sums = 48, one for each taxel, nothing is compressed" in said
    assert load_layout(tmp_path / "pad.toml").taxels == layout.taxels
    code, _, said = skin("plan", "--taxels", "1024", "--out", str(made))
    assert code == 2
    assert "is there already" in said
    code, _, said = skin("layout", "new", "10x10", "--out", str(made))
    assert code == 2
    assert "is there already" in said
    code, shown, _ = skin("layout", "new", "10x10", "--sending", "steps")
    assert code == 0
    assert parse_layout(shown.encode(), "shown").sending == "steps"


def test_a_design_takes_taxels_at_positions(skin: Verb, tmp_path: Path) -> None:
    lines = [f"{0.004 * (taxel % 16):.3f},{0.004 * (taxel // 16):.3f},0" for taxel in range(256)]
    (tmp_path / "pad.csv").write_text("x_m,y_m,z_m\n" + "\n".join(lines) + "\n")
    code, shown, _ = skin("plan", "--taxels", str(tmp_path / "pad.csv"))
    assert code == 0
    assert parse_layout(shown.encode(), "shown").taxels.positions is not None
