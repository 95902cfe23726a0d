"""Each difference from the plan, in logs of a few frames written here."""

from collections.abc import Sequence

import numpy as np
import pytest

from bandwidth.departures import counters, departures, foreign, heartbeats, sync
from bandwidth.measured import measure
from bandwidth.plan import plan_bus
from bandwidth.traffic import Disturbance
from dbc.contract import Contract
from dbc.frame import ERROR, EXTENDED, REMOTE, Frames, frames
from tests.layouts import in_one_instant

MS = 1_000_000
SKIN = Contract.from_layout(in_one_instant())


def made(rows: list[tuple[float, int, int]]) -> Frames:
    """Return frames of their times in milliseconds, identifiers and lengths."""
    found = frames(len(rows))
    for place, (time_ms, can_id, length) in enumerate(rows):
        found["time_ns"][place], found["can_id"][place], found["length"][place] = round(time_ms * MS), can_id, length
    return found


def syncs(times_ms: list[float], numbers: Sequence[int]) -> Frames:
    found = made([(time_ms, 0x80, 1) for time_ms in times_ms])
    found["data"][:, 0] = numbers
    return found


@pytest.mark.parametrize(
    ("mean_ms", "said"),
    [
        (9.89, ["SYNC every 9.890 ms, 10.000 ms were planned"]),
        (9.91, []),
        (10.09, []),
        (10.11, ["SYNC every 10.110 ms, 10.000 ms were planned"]),
    ],
)
def test_the_period_may_be_one_percent_off(mean_ms: float, said: list[str]) -> None:
    taken = syncs([mean_ms * cycle for cycle in range(100)], range(1, 101))
    assert list(sync(SKIN, taken, 100 * mean_ms * 1e-3)) == said


def test_counters_go_from_1_to_240_and_begin_anew() -> None:
    assert list(counters(syncs([0, 10, 20, 30], [239, 240, 1, 2]))) == []
    skipped = syncs([0, 10, 20, 30, 40], [239, 1, 2, 2, 4])
    assert list(counters(skipped)) == ["3 SYNC counters do not follow each other"]


def test_a_sync_is_one_byte() -> None:
    other = syncs([0, 10, 20], [1, 2, 3])
    assert list(sync(SKIN, other, 0.03)) == []
    other["length"][1:] = 0
    assert list(sync(SKIN, other, 0.03)) == ["2 SYNCs have another length than the planned 1 byte"]


def silent(beats_ms: list[float], seconds: float) -> list[str]:
    """Return what is said of node 1; the other nodes are heard twice a second."""
    others = [(500.0 * turn, 0x700 + node, 1) for turn in range(20) for node in range(2, 33)]
    rows = [(0.0, 0x80, 1), *others, *((time_ms, 0x701, 1) for time_ms in beats_ms)]
    return list(heartbeats(SKIN, 0, made(sorted(rows)), seconds))


@pytest.mark.parametrize(
    ("beats_ms", "seconds", "said_s"),
    [
        ([0, 1500, 3000], 4.5, None),  # one and a half periods
        ([0, 1501, 3000], 4.5, "1.5"),
        ([1499], 2.9, None),
        ([2000], 2.1, "2.0"),  # from the start of the log
        ([100], 2.1, "2.0"),  # to its end
        ([], 1.5, None),  # a log that is too short to tell
        ([], 1.6, "1.6"),
    ],
)
def test_a_node_is_silent_after_one_and_a_half_periods(
    beats_ms: list[float], seconds: float, said_s: str | None
) -> None:
    line = f"node 1: no heartbeat for {said_s} s, one every 1000 ms was planned"
    assert silent(beats_ms, seconds) == ([] if said_s is None else [line])


def cycle(*late: tuple[int, float]) -> list[str]:
    """Return what is said of one cycle in which identifiers come late, each by some milliseconds."""
    first = SKIN.cycle(0)
    first["data"][0, 0] = 1
    first["time_ns"] = 135_000 * np.arange(len(first))
    for can_id, by_ms in late:
        first["time_ns"][first["can_id"] == can_id] += round(by_ms * MS)
    end = syncs([10.0], [2])
    seen: Frames = np.concatenate([first[np.argsort(first["time_ns"], kind="stable")], end])
    planned = plan_bus(SKIN, 0, None, Disturbance())
    return departures(SKIN, 0, seen, planned, measure(SKIN, 0, seen, planned))


def test_up_to_four_late_nodes_have_a_line_each() -> None:
    assert cycle() == []
    found = cycle((0x181, 9), (0x182, 9), (0x183, 9), (0x184, 9))
    assert [line.split(" TPDOs later")[0] for line in found] == [f"bus0: node {node}: 1" for node in (1, 2, 3, 4)]
    assert all("the latest after 9." in line for line in found)
    found = cycle((0x181, 9), (0x182, 9), (0x184, 9), (0x28A, 4), (0x18B, 9))
    assert len(found) == 1
    assert found[0].startswith("bus0: nodes 1-2, 4, 10-11: late TPDOs; node 11: 1 TPDOs later than ")


def test_what_is_not_planned_has_its_share_of_the_bus() -> None:
    """Ten frames without data, of about 50 bits, in 10 s of 1 Mbit/s: 50 µs of each second."""
    rows = [(0.0, 0x80, 1), *((1000.0 * turn, 0x7F2, 0) for turn in range(10)), (10_000.0, 0x80, 1)]
    rows += [(20.0, 0x082, 8), (21.0, 0x082, 8)]
    seen = made(sorted(rows))
    planned = plan_bus(SKIN, 0, None, Disturbance())
    load = measure(SKIN, 0, seen, planned)
    found = list(foreign(load))
    assert found == ["node 2 sent 2 emergencies", "7F2h is not planned: 10 frames, 0.01% of the bus"]


@pytest.mark.parametrize("flag", [EXTENDED, REMOTE, ERROR])
def test_only_data_frames_with_an_identifier_of_11_bits_are_heartbeats(flag: int) -> None:
    taken = made([(0.0, 0x80, 1), *((100.0, 0x700 + node, 1) for node in range(1, 33))])
    assert list(heartbeats(SKIN, 0, taken, 1.6)) == []
    taken["flags"][5] = flag
    assert len(list(heartbeats(SKIN, 0, taken, 1.6))) == 1
