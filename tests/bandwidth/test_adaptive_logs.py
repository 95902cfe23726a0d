"""``skin plan``, ``skin load`` and ``skin plan --check`` for adaptive nodes, on logs of the arbitrated bus."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pytest

from bandwidth.adaptive_log import AGAIN, EARLY, NEW, REFINING, UNREFINED, sum_frames
from bandwidth.adaptive_plan import touched_load
from dbc.adaptive import FIRST_COB_ID
from dbc.contract import Contract
from dbc.frame import BRS, FD, Frames
from skin.layout import load_layout
from tests import layouts
from tests.bandwidth.adaptive_bus import run_bus
from tests.layouts import TPDOS

Run = Callable[..., tuple[int, str, str]]
NODES, TICKS, MS = 32, 3000, 1_000_000
#: Identifier of the first fine frame.
FIRST_FINE = 0x481


@pytest.fixture(autouse=True)
def _brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate no touch, which takes seconds; one test brings the simulation back."""
    monkeypatch.setattr("bandwidth.adaptive_plan.touched_load", lambda _contract, _bus: 0.0625)


def arbitrated(seed: int, layout: str = "adaptive") -> Frames:
    """Return three seconds of a bus: a touch moves under two nodes, then rests."""
    contract, rng = Contract.from_layout(load_layout(Path(layout))), np.random.default_rng(seed)
    line = contract.layout.bus[0]
    nodes = line.nodes
    sums_n = np.zeros((TICKS, nodes, 32), np.float32)
    sums_n[200:, 3:5] = rng.uniform(0.01, 0.06, (2, 32))
    sums_n[200:800, 3:5] += np.cumsum(rng.normal(0, 0.002, (600, 2, 32)), axis=0)
    sums_n[800:, 3:5] = sums_n[799, 3:5]
    sums_n[:, :, 0] = np.abs(sums_n[:, :, 0])
    beats = np.arange(nodes, dtype=np.int64) * 1000 // nodes * MS
    sent, _ = run_bus(line, contract.law, sums_n, np.full((TICKS, nodes), 1e-5), beats)
    sent["time_ns"] += 10**12
    return sent


def is_coarse(sent: Frames) -> np.ndarray:
    return (sent["can_id"] >= FIRST_COB_ID) & (sent["can_id"] < FIRST_FINE)


def is_fine(sent: Frames) -> np.ndarray:
    return (sent["can_id"] >= FIRST_FINE) & (sent["can_id"] < FIRST_COB_ID + NODES * TPDOS)


def written(path: Path, buses: list[Frames]) -> Path:
    with can.Logger(path) as logger:
        times = [
            (int(each["time_ns"]), bus, place) for bus, sent in enumerate(buses) for place, each in enumerate(sent)
        ]
        for time_ns, bus, place in sorted(times):
            each = buses[bus][place]
            data = each["data"][: each["length"]].tobytes()
            message = can.Message(time_ns * 1e-9, int(each["can_id"]), is_extended_id=False, data=data)
            message.is_fd, message.bitrate_switch = bool(each["flags"] & FD), bool(each["flags"] & BRS)
            message.channel = f"bus{bus}"
            logger(message)
    return path


@pytest.fixture(scope="module")
def buses() -> list[Frames]:
    return [arbitrated(seed) for seed in range(4)]


@pytest.fixture(scope="module")
def log(buses: list[Frames], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("logs") / "adaptive.log", buses)


def broken(buses: list[Frames], tmp_path: Path, change: Callable[[Frames], Frames]) -> Path:
    changed = [buses[0], change(buses[1].copy()), *buses[2:]]
    return written(tmp_path / "broken.log", changed)


@pytest.mark.heavy
def test_the_load_of_a_touch_is_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bandwidth.adaptive_plan.TOUCHED_S", 2.0)
    contract = Contract.from_layout(load_layout(Path("adaptive")))
    # The first object presses: a few percent of the bus, more than heartbeats and SYNC, and far from full.
    assert 0.0036 < touched_load(contract, 2) < 0.2


def test_a_plan_has_loads_and_bounds(skin: Run) -> None:
    status, out, said = skin("plan", "adaptive", "--json", "--node-budget", 24_000)
    document = json.loads(out)
    assert (status, said, document["fits"]) == (0, "", True)
    bus = document["buses"][2]
    assert bus["load_idle"] == pytest.approx(0.0024, abs=1e-4)
    assert (bus["load_touched"], bus["load_worst"]) == (pytest.approx(0.0625 + bus["load_idle"], abs=1e-4), 1)
    assert bus["coarse_ms"] == max(node["coarse_ms"] for node in bus["node_plans"])
    assert bus["coarse_ms"] == pytest.approx(43.7, abs=0.1)
    assert bus["heartbeat_response_ms"] < 200
    assert 24_000 < bus["budget_80_bits_per_s"] < 25_000
    assert bus["budget"]["load"] == pytest.approx(0.771, abs=1e-3)
    table = skin("plan", "adaptive")[1]
    assert "coarse sums, everything moves" in table
    assert "32: 43.71" in table


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plan", "--node-budget", "5000"], "--node-budget is for adaptive sending"),
        (["plan", "adaptive", "--node-budget", "-1"], "expected a budget of 0 (none), or of 528 bit/s or more, got -1"),
        (["plan", "adaptive", "--node-budget", "527"], "refreshes take 528 bit/s of a node"),
        (["plan", "adaptive", "--plot", "p"], "adaptive nodes send none"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(skin: Run, arguments: list[str], said: str) -> None:
    status, out, words = skin(*arguments)
    assert (status, out) == (2, "")
    assert said in words


@pytest.mark.heavy
def test_a_slow_bus_does_not_fit_and_says_how_many_nodes_would(skin: Run, tmp_path: Path) -> None:
    path = tmp_path / "slow.toml"
    path.write_text(layouts.layout_toml(64, 64, **layouts.ADAPTIVE, bus=layouts.buses(*4 * [32], bitrate=250_000)))
    status, out, _ = skin("plan", path)
    assert status == 1
    # 32 nodes x 4 groups x 135 bits of 4 µs.
    assert "32 nodes send for 69.1 ms what has waited for 24 ms; 10 nodes or a" in " ".join(out.split())


@pytest.mark.heavy
def test_frames_say_what_they_are(buses: list[Frames]) -> None:
    contract = Contract.from_layout(load_layout(Path("adaptive")))
    sums = sum_frames(contract, 0, buses[0])
    assert set(np.unique(sums.node_id)) == {4, 5}
    assert set(sums.says.tolist()) == {NEW, AGAIN, REFINING}
    # A log that begins with a fine frame, and one that lacks coarse frames.
    fine = is_fine(buses[0])
    assert sum_frames(contract, 0, buses[0][np.argmax(fine) :]).says[0] == EARLY
    lacking = buses[0][(np.arange(len(fine)) % 3 > 0) | fine]
    assert UNREFINED in sum_frames(contract, 0, lacking).says


@pytest.mark.heavy
def test_load_of_a_log_by_level_and_node(skin: Run, log: Path, buses: list[Frames]) -> None:
    status, out, said = skin("load", log, "--layout", "adaptive", "--json")
    assert (status, said) == (0, "")
    for each, sent in zip(json.loads(out)["buses"], buses, strict=True):
        levels = {(level["kind"], level["level"]): level for level in each["levels"]}
        assert len(levels) == 8
        ids = sent["can_id"]
        whole = (np.cumsum(ids == 0x80) > 0) & (np.cumsum(ids == 0x80) < (ids == 0x80).sum())
        assert sum(level["frames"] for level in levels.values()) == (whole & (ids > 0x180) & (ids <= 0x580)).sum()
        assert each["load_exact"] == pytest.approx(sum(node["load_exact"] for node in each["nodes"]), abs=2e-3)
        moved = [node for node in each["nodes"] if node["news"]]
        assert [node["node_id"] for node in moved] == [4, 5]
        assert all(node["again"] and node["fine"] and not node["unrefined"] for node in moved)
        assert {node["heartbeats"] for node in each["nodes"]} <= {2, 3}
    table = skin("load", log, "--layout", "adaptive")[1]
    assert "coarse, level 5" in table
    assert "heartbeat" in table
    # SYNC every 100 ms, of 58 bits with its stuff bits.
    assert len(re.findall(r"^SYNC +29 +10\.0 +0\.058%", table, re.MULTILINE)) == 4


def test_a_log_of_the_layout_has_no_difference(skin: Run, log: Path) -> None:
    assert skin("plan", "adaptive", "--check", log)[:2] == (0, "")


@pytest.mark.heavy
def test_check_names_each_difference(skin: Run, buses: list[Frames], tmp_path: Path) -> None:
    def checked(change: Callable[[Frames], Frames]) -> str:
        status, out, _ = skin("plan", "adaptive", "--check", broken(buses, tmp_path, change))
        assert status == 1
        return out

    def unchecked(sent: Frames) -> Frames:
        sent["data"][is_fine(sent), 7] ^= 0xFF
        return sent

    def short(sent: Frames) -> Frames:
        sent["length"][is_coarse(sent)] = 7
        return sent

    def early(sent: Frames) -> Frames:
        sync = np.flatnonzero(sent["can_id"] == 0x80)[5]
        added = sent[is_coarse(sent)][:4].copy()
        added["time_ns"] = sent["time_ns"][sync] + 200_000 * (1 + np.arange(4))
        whole: Frames = np.concatenate([sent[: sync + 1], added, sent[sync + 1 :]])
        return whole

    def silent(sent: Frames) -> Frames:
        is_gone = (sent["time_ns"] > 10**12 + 1000 * MS) & ((sent["can_id"] - 0x181) % 32 == 3)
        kept: Frames = sent[~is_gone]
        return kept

    def foreign(sent: Frames) -> Frames:
        sent["can_id"][sent["can_id"] == 0x701] = 0x7F1
        return sent

    said = checked(unchecked)
    assert "node 4: " in said
    assert "do not refine the newest coarse frame" in said
    assert "have another length or format" in checked(short)
    assert "began in the 2 ms after a SYNC" in checked(early)
    assert "was silent for" in checked(silent)
    said = checked(foreign)
    assert "bus1: 7F1h is not planned" in said
    assert "bus1: node 1: no heartbeat" in said


def test_a_log_of_a_skin_that_sends_in_cycles_is_noticed(skin: Run, tmp_path: Path) -> None:
    contract, rng = Contract.from_layout(load_layout()), np.random.default_rng(0)
    buses = []
    for bus in range(4):
        parts = []
        for cycle in range(20):
            part = contract.cycle(bus)
            part["time_ns"] = 10**12 + 10 * MS * cycle + 135_000 * np.arange(len(part))
            part["data"][1:, :8] = rng.integers(0, 256, (len(part) - 1, 8))
            parts.append(part)
        buses.append(np.concatenate(parts))
    status, out, _ = skin("plan", "adaptive", "--check", written(tmp_path / "cycles.log", buses))
    assert status == 1
    assert "SYNC every 10.000 ms, 100.000 ms were planned" in out


@pytest.fixture(scope="module")
def fd_buses() -> list[Frames]:
    return [arbitrated(seed, "adaptive-fd") for seed in range(2)]


@pytest.mark.heavy
def test_plan_load_and_check_of_can_fd(skin: Run, fd_buses: list[Frames], tmp_path: Path) -> None:
    status, out, _ = skin("plan", "adaptive-fd", "--json", "--node-budget", 10_000)
    bus = json.loads(out)["buses"][0]
    assert (status, bus["nodes"], bus["budget"]["full_ms"] is not None) == (0, 64, True)
    assert bus["coarse_ms"] == pytest.approx(33.1, abs=0.1)
    path = written(tmp_path / "fd.log", fd_buses)
    status, out, said = skin("load", path, "--layout", "adaptive-fd", "--json")
    assert (status, said) == (0, "")
    for each in json.loads(out)["buses"]:
        moved = [node for node in each["nodes"] if node["news"]]
        assert [node["node_id"] for node in moved] == [4, 5]
        assert all(node["fine"] and not node["unrefined"] for node in moved)
        assert sum(level["frames"] for level in each["levels"]) > 50
    assert skin("plan", "adaptive-fd", "--check", path)[:2] == (0, "")


def test_check_names_differences_on_can_fd(skin: Run, fd_buses: list[Frames], tmp_path: Path) -> None:
    def checked(change: Callable[[Frames], Frames]) -> str:
        path = written(tmp_path / "broken.log", [fd_buses[0], change(fd_buses[1].copy())])
        status, out, _ = skin("plan", "adaptive-fd", "--check", path)
        assert status == 1
        return out

    def unchecked(sent: Frames) -> Frames:
        sent["data"][sent["length"] == 64, 63] ^= 0xFF
        return sent

    def short(sent: Frames) -> Frames:
        sent["length"][sent["length"] == 32] = 24
        return sent

    def silent(sent: Frames) -> Frames:
        is_gone = (sent["time_ns"] > 10**12 + 1000 * MS) & ((sent["can_id"] - 0x181) % 128 == 3)
        kept: Frames = sent[~is_gone]
        return kept

    assert "do not refine" in checked(unchecked)
    assert "have another length or format" in checked(short)
    assert "node 4 was silent for" in checked(silent)
