"""``skin load`` for boards with slots, on a log of an arbitrated bus."""

import json
from pathlib import Path

import can
import numpy as np
import pytest

from bandwidth.departures import departures
from bandwidth.measured import measure
from bandwidth.plan import plan
from bus.polling import poll
from bus.simulated_bus import SimulatedBus
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.patch_filter import SAMPLE_NS
from evaluation.schemes.wire import heartbeats
from nodes.steps.simulated import SimulatedNodes, sync_frames
from tests.layouts import STEPPED, buses, layout_toml, small_layout
from tests.processes import Verb

MS, TICKS = 1_000_000, 5000
TABLES = {**STEPPED, "bus": buses(2, names=["arm"])}
CONTRACT = Contract.from_layout(small_layout(**TABLES))
PLANS = plan(CONTRACT, is_touched=False)
FIRST, SECOND = 0x181, 0x182


@pytest.fixture(scope="module")
def sent() -> Frames:
    """Return five seconds of a bus: the sums of the first board move for one second, all others rest."""
    sums_n = np.zeros((TICKS, 2, 32), np.float32)
    sums_n[1000:2000, 0, 0] = np.linspace(0, 0.1, 1000)
    sums_n[2000:, 0, 0] = 0.1
    still, noise_n = np.zeros_like(sums_n[0]), np.full(2, 1e-3)
    nodes = SimulatedNodes(CONTRACT, 0, lambda tick: (sums_n[tick], still, noise_n))
    others = np.concatenate([sync_frames(CONTRACT.layout, TICKS), heartbeats(CONTRACT.layout.bus[0], TICKS)])
    return poll(SimulatedBus(1_000_000, None), nodes, others, TICKS, SAMPLE_NS)


def said(seen: Frames) -> list[str]:
    return departures(CONTRACT, 0, seen, PLANS[0], measure(CONTRACT, 0, seen, PLANS[0]))


def test_a_log_of_the_layout_has_no_difference(sent: Frames) -> None:
    assert said(sent) == []
    # Sums of both boards, of the moving one many.
    moving, resting = ((sent["can_id"] == each).sum() for each in (FIRST, SECOND))
    assert moving > 50
    assert 10 < resting < 25


def test_a_frame_names_its_slot_and_may_be_late(sent: Frames) -> None:
    late = sent.copy()
    place = np.flatnonzero(late["can_id"] == FIRST)[-3]
    late["time_ns"][place] += 12 * MS
    late = late[np.argsort(late["time_ns"], kind="stable")]
    (line,) = said(late)
    assert line.startswith(
        f"arm: node 1: 1 TPDOs later than {PLANS[0].node_plans[0].response_ms:.2f} ms after its sample"
    )
    assert "the latest after 11." in line


def test_a_board_is_never_silent_for_longer_than_its_checks_are_apart(sent: Frames) -> None:
    gone = sent[(sent["can_id"] != SECOND) | (sent["time_ns"] < 1000 * MS)]
    most_s = (CONTRACT.keep_max + 4) * CONTRACT.layout.steps.slot_s
    (line,) = said(gone)
    assert line.startswith("arm: node 2: no sums for ")
    assert line.endswith(f" s, a check every {most_s:.1f} s was planned")


def test_frames_of_sums_have_the_length_of_their_words(sent: Frames) -> None:
    short = sent.copy()
    short["length"][np.flatnonzero(short["can_id"] == SECOND)[:3]] = 7
    assert "arm: node 2: 3 TPDOs have another length or format" in said(short)


def test_without_syncs_slots_cannot_be_told(sent: Frames) -> None:
    assert said(sent[sent["can_id"] != 0x80]) == ["arm: no SYNC: cycles cannot be told apart"]


def test_the_load_of_a_log_is_that_of_its_frames_by_node(
    skin: Verb, sent: Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bandwidth.plan.touched_load", lambda _contract, _bus: 0.0625)
    layout, log = tmp_path / "arm.toml", tmp_path / "arm.log"
    layout.write_text(layout_toml(**TABLES))
    with can.Logger(log) as logger:
        for each in sent:
            data = each["data"][: each["length"]].tobytes()
            logger(
                can.Message(
                    1000 + each["time_ns"] * 1e-9, int(each["can_id"]), is_extended_id=False, data=data, channel="arm"
                )
            )
    status, out, words = skin("load", log, "--layout", layout, "--json")
    assert (status, words) == (0, "")
    (bus,) = json.loads(out)["buses"]
    of_node = {node["node_id"]: node["frames"] for node in bus["nodes"]}
    is_whole = (np.cumsum(sent["can_id"] == 0x80) > 0) & (np.cumsum(sent["can_id"] == 0x80) < TICKS // 100)
    for node in (1, 2):
        assert of_node[node] == (is_whole & np.isin(sent["can_id"], [0x180 + node, 0x700 + node])).sum()
    assert bus["load_exact"] == pytest.approx(sum(node["load_exact"] for node in bus["nodes"]))
    assert bus["plan_touched"] == pytest.approx(0.0625 + 12 * 58e-6)
    assert skin("load", log, "--layout", layout, "--check")[:2] == (0, "")
    assert "SYNC" in skin("load", log, "--layout", layout)[1]
