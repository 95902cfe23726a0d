"""Plans: published rates, the arbitrated bus as judge, and what is said when something does not fit."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from bandwidth.plan import BusTime, bus_time, plan, plan_bus, planned
from bandwidth.search import with_buses
from bandwidth.traffic import Disturbance, traffic
from bandwidth.wiring import wiring
from bus.simulated_bus import SimulatedBus
from canskin.errors import LayoutError
from dbc.codec import encode
from dbc.contract import Contract, sync_frame
from dbc.frame import frames
from nodes.electronics import Electronics
from skin.layout import SHIPPED, Layout, changed, layout_text, load_layout, parse_layout
from skin.sources import load_source
from skin.sync_counter import SYNC_OVERFLOW
from tests.layouts import buses, small_layout

#: Shipped layouts whose nodes send in every cycle; `test_slots` plans the others.
IN_CYCLES = [name for name in SHIPPED if load_layout(Path(name)).sending == "synchronous"]


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("name", "average_hz", "worst_hz"),
    [("default", 2 * 134.5, 2 * 113.8), ("fd", 216, 184), ("one-bus-12bit", 36.6, 31.1), ("recognition", 671.1, 572.5)],
)
def test_rates_of_the_shipped_layouts(name: str, average_hz: float, worst_hz: float) -> None:
    for each in plan(Contract.from_layout(load_layout(Path(name)))):
        assert each.max_rate_hz_random == pytest.approx(average_hz, rel=0.01)
        assert each.max_rate_hz_worst == pytest.approx(worst_hz, rel=0.01)
        assert each.problems == []
        assert each.load_touched <= each.load_worst
        assert each.max_rate_hz_worst_80 < each.max_rate_hz_worst < each.max_rate_hz_touched


@pytest.mark.parametrize("name", ["default", "fd", "steps"])
def test_time_is_part_of_the_load(name: str) -> None:
    """TIME of 6 bytes ten times a second: 34 + 48 bits, at most 20 stuff bits, 10 + 3 bits of the end."""
    before, timed = (with_time(name, time_s) for time_s in (None, 0.1))
    more = load_worst(timed) - load_worst(before)
    assert more == pytest.approx(10 * 115e-6)


def test_time_does_not_fit_a_full_window() -> None:
    before, timed = (plan_bus(with_time("default", time_s), 0, None, Disturbance()) for time_s in (None, 60.0))
    assert before.problems == []
    assert 0.09 < timed.window_needed_ms - before.window_needed_ms < 0.14
    assert "0.08 ms are missing" in timed.problems[0]
    assert plan_bus(with_time("fd", 60.0), 0, None, Disturbance()).problems == []


def test_a_plan_is_that_of_its_frames() -> None:
    """Two nodes with two TPDOs of 8 bytes: 135 bits at most, SYNC 65 (in the mean 57 and 154/240), heartbeats 65 (58).

    From SYNC: 1 ms of jitter, a frame on its way, SYNC, TPDOs in their order. An SDO response waits for the request on
    its way, SYNC and TPDOs; a heartbeat for both SDO frames and the other heartbeat, too.
    """
    contract = Contract.from_layout(small_layout(bus=buses(2, names=["arm"])))
    planned = plan_bus(contract, 0, np.array([500.0, 0.0]), Disturbance())
    assert (planned.name, planned.nodes, planned.bitrate, planned.data_bitrate) == ("arm", 2, 1_000_000, None)
    assert (planned.frames_per_cycle, planned.bits_per_cycle_worst, planned.bits_per_cycle_touched) == (
        5,
        605,
        pytest.approx(500 + 57 + 154 / 240),
    )
    assert planned.bits_per_cycle_random == pytest.approx(4 * 114.2 + 57.64, rel=0.01)
    assert planned.load_worst == pytest.approx(605e-6 * 100 + 2 * 65e-6)
    assert planned.load_touched == pytest.approx(557.64e-6 * 100 + 2 * 58e-6, rel=1e-5)
    assert planned.load_random == pytest.approx(planned.bits_per_cycle_random * 1e-4 + 2 * 58e-6)
    assert planned.max_rate_hz_worst == pytest.approx((1 - 130e-6) / 605e-6)
    assert planned.max_rate_hz_worst_80 == pytest.approx((0.8 - 130e-6) / 605e-6)
    assert planned.max_rate_hz_touched == pytest.approx((1 - 116e-6) / 557.64e-6, rel=1e-5)
    random_s = planned.bits_per_cycle_random * 1e-6
    assert planned.max_rate_hz_random == pytest.approx((1 - 116e-6) / random_s)
    assert planned.max_rate_hz_random_80 == pytest.approx((0.8 - 116e-6) / random_s)
    assert planned.window_ms == pytest.approx(9.9)
    assert planned.window_needed_ms == pytest.approx(1 + 0.135 + 0.065 + 4 * 0.135)
    waits = [(each.node_id, each.frames_per_cycle, each.response_ms) for each in planned.node_plans]
    assert waits == [(1, 2, pytest.approx(1.74 - 0.135)), (2, 2, pytest.approx(1.74))]
    assert planned.sdo_response_ms == pytest.approx(0.135 + 0.065 + 4 * 0.135 + 0.135)
    assert planned.heartbeat_response_ms == pytest.approx(3 * 0.065 + 6 * 0.135)
    assert (planned.receive_buffer_frames, planned.receive_buffer_bytes) == (12, 12 * 896)
    assert planned.problems == []


def with_time(name: str, time_s: float | None) -> Contract:
    layout = load_layout(Path(name))
    return Contract.from_layout(changed(layout, sync={"time_s": time_s}))


def load_worst(contract: Contract) -> float:
    return bus_time(traffic(contract, 0), "worst").load(contract.layout.sync.rate_hz)


@pytest.mark.heavy
@pytest.mark.parametrize("name", IN_CYCLES)
def test_average_load_is_that_of_the_arbitrated_bus(name: str) -> None:
    """Two seconds of one touch after another on the virtual bus, every frame sent as nodes send it."""
    layout = load_layout(Path(name))
    contract = Contract.from_layout(layout)
    taxels = layout.taxels
    source = load_source("objects", rows=taxels.rows, columns=taxels.columns, pitch_m=taxels.pitch_m, seed=5)
    electronics = Electronics(taxels, seed=5)
    wires = [SimulatedBus(each.bitrate, each.data_bitrate) for each in layout.bus]
    stations = [(wire.attach("nodes", queue_size=1000), wire.attach("gateway")) for wire in wires]
    table = contract.table
    period_ns = round(layout.sync.period_s * 1e9)
    cycles = 200
    for cycle in range(cycles):
        counter = cycle % SYNC_OVERFLOW + 1
        sums = np.asarray(contract.phi.forward(electronics.read(source.frame(5 * cycle).force_n)), np.int32)
        due = table.turn == contract.turn_of(counter)
        burst = frames(int(due.sum()))
        burst["can_id"], burst["length"], burst["flags"] = table.cob_id[due], table.length[due], table.flags[due]
        payloads = encode(counter, sums, table.gather[due], contract.packing)
        burst["data"][:, : payloads.shape[1]] = payloads
        burst["port"] = table.node[due]
        burst["time_ns"] = cycle * period_ns
        sync = sync_frame(counter)
        sync["time_ns"] = cycle * period_ns
        for number, (wire, (nodes, gateway)) in enumerate(zip(wires, stations, strict=True)):
            wire.submit(gateway, sync)
            mine = burst[table.bus[due] == number]
            if cycle % round(1 / layout.sync.period_s) == 0:
                mine = np.concatenate([mine, heartbeats(contract.on_bus(number), cycle * period_ns)])
            assert wire.submit(nodes, mine) == len(mine)
            wire.run_until((cycle + 1) * period_ns)
    for wire, expected in zip(wires, plan(contract), strict=True):
        assert wire.counts.busy_ns / (cycles * period_ns) == pytest.approx(expected.load_touched, rel=0.01)


def heartbeats(nodes: tuple[object, ...], time_ns: int) -> np.ndarray:
    beats = frames(len(nodes))
    beats["can_id"] = [0x700 + node.node_id for node in nodes]  # type: ignore[attr-defined]
    beats["length"], beats["data"][:, 0], beats["time_ns"] = 1, 5, time_ns
    beats["port"] = 1000 + np.arange(len(nodes))
    return beats


def faster(layout: Layout, rate_hz: float) -> Layout:
    return changed(layout, sync={"rate_hz": rate_hz})


@pytest.mark.heavy
def test_a_bus_that_is_asked_for_too_much_says_what_is_missing() -> None:
    planned = plan(Contract.from_layout(faster(load_layout(), 260)))[0]
    assert planned.window_needed_ms is None
    assert planned.node_plans[-1].response_ms is None
    assert planned.node_plans[0].response_ms is not None
    missing = round((planned.load_worst - 1) * 1e6)
    assert f"{missing} bits a second are missing" in planned.problems[0]
    tight = plan(Contract.from_layout(faster(load_layout(), 224)))[0]
    assert tight.load_worst < 1
    assert "the window (1007h) is 4.42 ms" in tight.problems[0]


@pytest.mark.heavy
def test_errors_and_sdo_lengthen_responses() -> None:
    contract = Contract.from_layout(load_layout())
    calm, rough = (
        plan(contract, allowed=Disturbance(0.0, 0.0, 0.0))[0],
        plan(contract, allowed=Disturbance(1e-4, 20, 100))[0],
    )
    assert calm.sdo_response_ms is None
    assert calm.window_needed_ms is not None
    assert rough.window_needed_ms == pytest.approx(calm.window_needed_ms + 0.1 + 0.166, abs=1e-6)


@pytest.mark.parametrize("name", SHIPPED)
def test_layout_text_is_read_back_as_the_same_layout(name: str) -> None:
    layout = load_layout(Path(name))
    assert parse_layout(layout_text(layout).encode(), "again") == layout


def test_a_layout_that_a_program_has_built_is_checked() -> None:
    crowded = with_buses(load_layout(), 2, load_layout().bus[0])
    with pytest.raises(LayoutError, match="no identifiers left"):
        planned(changed(crowded, encoding={"sum_bits": 16}, measurement={"sums": 4096}), Disturbance())


def few(rows: Sequence[Sequence[int]] = ((0, 0), (1, 1)), **of_buses: int) -> Layout:
    bus = buses(*2 * [4 // of_buses.get("blocks_per_node", 1)], names=("left", "right"), **of_buses)
    return small_layout(16, 16, taxels={"adc_bits": 16}, measurement={"rows": rows}, bus=bus)


def test_a_bus_whose_nodes_send_no_sums_has_heartbeats_alone_and_no_problem() -> None:
    left, right = plan(Contract.from_layout(few()))
    assert (left.problems, right.problems) == ([], [])
    assert [(each.node_id, each.frames_per_cycle) for each in left.node_plans] == [(1, 1), (2, 1)]
    assert (right.node_plans, right.frames_per_cycle) == ([], 1)  # SYNC


def test_conversions_of_a_node_are_those_of_its_taxels_or_of_its_analogue_sums() -> None:
    assert wiring(load_layout()).conversions_per_s == 32 * 1000
    assert wiring(load_layout(Path("analogue"))).conversions_per_s == 8 * 100


def test_blocks_that_send_no_sum_need_no_wires() -> None:
    """Rows of one block and of two: a chain each."""
    one, two = (wiring(few(rows)) for rows in ([[0, 0], [0, 1]], [[0, 0], [1, 1]]))
    assert one.wires_m == one.longest_chain_m
    assert two.wires_m > two.longest_chain_m


def test_heartbeats_that_fill_a_bus_leave_no_rate() -> None:
    full = BusTime(cycle_s=0.001, cycle_bits=1000, beats_s=0.5)
    assert full.load(100) == pytest.approx(0.6)
    assert [full.rate_hz(), full.rate_hz(0.6), full.rate_hz(0.4)] == pytest.approx([500.0, 100.0, 0.0])


def test_a_node_converts_the_taxels_of_blocks_that_send() -> None:
    """Nodes of two blocks of 32 taxels, and a SYNC rate of 100 Hz."""
    rates = [
        wiring(few(rows, blocks_per_node=2)).conversions_per_s
        for rows in ([[0, 0]], [[0, 0], [2, 2]], [[0, 0], [1, 1]])
    ]
    assert rates == [32 * 100, 32 * 100, 64 * 100]
