"""What a layout gets that leaves keys out: the choice agrees with the plan of the buses."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bandwidth.plan import planned
from bandwidth.traffic import Disturbance
from canskin.errors import LayoutError
from skin.choice import COMPRESSIONS, ROOM, carries, chosen, scan_words, worst_load
from skin.layout import Layout, changed, load_layout
from tests.layouts import any_layout, buses

#: A load so near to `ROOM` may be judged differently.
NEAR = 0.03


@st.composite
def layouts(draw: st.DrawFn) -> Layout:
    """Return layouts of one bus whose sums are chosen."""
    rows, columns = draw(st.integers(4, 24)), draw(st.integers(8, 24))
    size, per_node = draw(st.sampled_from([16, 32, 64])), draw(st.sampled_from([1, 2]))
    blocks = -(-rows * columns // size)
    assume(blocks % per_node == 0)
    wires: dict[str, Any] = draw(st.sampled_from([{}, {"fd": True}, {"fd": True, "data_bitrate": 5_000_000}]))
    other = {"name": "drive", "identifier": 0x701, "is_extended": True, "period_s": 0.002}
    foreign = [other] if draw(st.booleans()) else []
    return any_layout(
        rows,
        columns,
        measurement={"block_size": size},
        sync={"rate_hz": draw(st.sampled_from([10.0, 50.0, 100.0, 300.0]))},
        encoding={"sum_bits": draw(st.sampled_from([8, 12, 16]))},
        bus=buses(blocks // per_node, blocks_per_node=per_node, **wires, foreign=foreign),
    )


@given(layouts())
@settings(max_examples=40, deadline=None)
def test_as_many_sums_are_chosen_as_the_plan_has_room_for(layout: Layout) -> None:
    fitting = []
    for sums in (layout.places // each for each in COMPRESSIONS):
        try:
            (plan,) = planned(changed(layout, measurement={"sums": sums}), Disturbance())
        except LayoutError:  # no identifiers
            assert not carries(layout, sums)
            continue
        load = worst_load(layout, sums)
        assert plan.load_worst - 1e-9 <= load <= 1.03 * plan.load_worst + 0.01
        assume(abs(plan.load_worst - ROOM) > NEAR)
        fitting += [sums] if plan.load_worst <= ROOM and not plan.problems else []
        assert carries(layout, sums, ROOM) <= (sums in fitting)
        has_time = not plan.problems and (plan.window_needed_ms or 0.0) < 0.9 * plan.window_ms
        assert carries(layout, sums, ROOM) or not (plan.load_worst < ROOM and has_time)
    assert layout.measurement.sums <= max(fitting, default=layout.places)


@pytest.mark.parametrize(
    ("rows", "columns", "tables", "sums", "samples", "wires"),
    [
        (24, 32, {"sync": {"rate_hz": 50.0}}, 384, 20, 1),
        (24, 32, {}, 192, 10, 1),
        (37, 11, {}, 208, 10, 1),
        (64, 64, {}, 1024, 10, 4),
        (8, 8, {"sync": {"rate_hz": 1000.0}, "bus": buses(2, fd=True, data_bitrate=5_000_000)}, 64, 1, 1),
        (24, 32, {"measurement": {"wiring": "board"}}, 768, 10, 4),  # a part of the sums of neighbours is not enough
        (24, 32, {"taxels": {"frontend": "analogue", "rows": 24, "columns": 32}}, 192, 1, 1),
        (24, 32, {"measurement": {"sums": 96}, "sampling": {"rate_hz": 100.0}}, 96, 1, 1),
    ],
)
def test_what_is_chosen(rows: int, columns: int, tables: dict[str, Any], sums: int, samples: int, wires: int) -> None:
    layout = any_layout(rows, columns, **tables)
    assert (layout.measurement.sums, layout.samples_per_sync, len(layout.bus)) == (sums, samples, wires)


def test_what_was_chosen_is_told_with_its_reason() -> None:
    tables = {"sync": {"rate_hz": 50.0}}
    assert chosen(any_layout(24, 32, **tables), tables) == [
        "bus: 1 of classic CAN, the fewest that carry the sums",
        "sampling.rate_hz = 1000: 20 in a cycle, averaged for less noise",
        "measurement.sums = 384, one for 2 taxels: buses up to 65% full; 768 would take 130%",
    ]
    whole = {"bus": buses(24), "sampling": {"rate_hz": 100.0}, "measurement": {"sums": 192}}
    assert chosen(any_layout(24, 32, **whole), whole) == []


@pytest.mark.parametrize(
    ("tables", "why"),
    [
        ({"sync": {"rate_hz": 300.0}, "bus": buses(4)}, "64 would come late"),
        ({"sync": {"rate_hz": 0.1}, "bus": buses(16, blocks_per_node=8)}, "4096 would lack identifiers"),
    ],
)
def test_why_there_are_no_more_sums(tables: dict[str, Any], why: str) -> None:
    side = 64 if "identifiers" in why else 11
    assert any(why in words for words in chosen(any_layout(side, side, **tables), tables))


def test_a_scan_that_serves_as_well_is_told() -> None:
    """One bus of two boards: four frames of eight 7-bit taxels each, SYNC, and two heartbeats."""
    small = any_layout(8, 8)
    rate_hz = (0.8 - 2 * 65e-6) / (65e-6 + 8 * 135e-6)
    assert f"fits these buses at {rate_hz:.1f} Hz and is as good" in scan_words(small)
    assert "fits these buses at 50.4 Hz and is as good" in scan_words(load_layout())
    assert "is as good" not in scan_words(load_layout(Path("steps")))
    in_turns = any_layout(8, 8, sync={"rate_hz": 200.0, "turns": 2})
    assert "fits these buses at 661.0 Hz" in scan_words(in_turns)  # each round of turns has two SYNCs
    assert not scan_words(any_layout(8, 8, taxels={"rows": 8, "columns": 8, "frontend": "analogue"}))
