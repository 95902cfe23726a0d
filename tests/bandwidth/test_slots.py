"""Plans of boards with slots: loads, and the bound of lateness against an arbitrated bus in which every board sends."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bandwidth import plan as planning
from bandwidth.plan import cycle_hz, plan, touched_load
from bandwidth.slots import slot_responses_ns
from bandwidth.traffic import Disturbance, traffic
from bus.simulated_bus import SimulatedBus
from dbc.contract import Contract
from dbc.dictionary import slot_offset_us
from dbc.frame import Frames, frames
from skin.layout import load_layout
from tests.layouts import STEPPED, buses, small_layout

MS = 1_000_000
US = 1_000


def contract_of(
    *nodes: int, slot_s: float = 0.005, quiet: float = 0.1, at_sync: bool = False, **bus: object
) -> Contract:
    rate = {"sync": {"rate_hz": 1 / slot_s}} if at_sync else {}
    steps = {"slot_s": slot_s, "quiet": quiet, "at_sync": at_sync}
    return Contract.from_layout(
        small_layout(8, 4 * sum(nodes), **STEPPED, **rate, steps=steps, bus=buses(*nodes, **bus))
    )


def bound_us(contract: Contract, allowed: Disturbance | None = None) -> list[float]:
    """Return the bounds of the TPDOs of the first bus with the most stuff bits, microseconds."""
    allowed = allowed or Disturbance(jitter_s=0.0, sdo_per_s=0.0)
    streams = traffic(contract, 0, allowed=allowed)
    return (slot_responses_ns(contract, streams, streams.worst_ns, allowed) / US).tolist()


def test_a_frame_waits_for_sync_for_what_was_queued_late_and_for_one_frame_on_its_way() -> None:
    """Frames of 135 us at most, SYNC of 65 us. The second board has its place 2.5 ms after the first, which may be
    queued 1 ms late: they do not meet. The last frame is blocked by a heartbeat of 65 us only.
    """
    assert bound_us(contract_of(2)) == [135 + 65 + 135, 65 + 65 + 135]
    # Places 0.5 ms apart: the first of ten boards may be queued as late as the second and third.
    assert bound_us(contract_of(10))[2] == 135 + 65 + 2 * 135 + 135


def test_boards_that_send_at_sync_wait_for_all_of_higher_priority() -> None:
    waits = bound_us(contract_of(10, at_sync=True))
    assert waits == [135 + 65 + 135 * (1 + place) for place in range(9)] + [65 + 65 + 10 * 135]


def test_the_time_from_the_sample_to_the_queue_is_part_of_the_bound() -> None:
    first = bound_us(contract_of(1), Disturbance(jitter_s=2e-4, sdo_per_s=0.0))
    assert first == [200 + 65 + 65 + 135]


def test_errors_have_frames_sent_again() -> None:
    """31 bits and the longest frame, once in 10 ms."""
    calm, rough = (bound_us(contract_of(2), Disturbance(0.0, 0.0, errors)) for errors in (0.0, 100.0))
    assert [after - before for before, after in zip(calm, rough, strict=True)] == [166, 166]


def test_a_full_bus_has_bounds_for_high_priorities_only() -> None:
    waits = np.array(bound_us(contract_of(40)))
    assert (waits[:8] < 3000).all()
    assert waits[-1] == pytest.approx(2**63 / 1000)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 36), st.booleans(), st.integers(0, 2**32))
def test_no_frame_of_an_arbitrated_bus_is_later_than_its_bound(nodes: int, at_sync: bool, seed: int) -> None:
    """Every board sends in every slot, queued within a sample of its place in the slot."""
    contract, random = contract_of(nodes, at_sync=at_sync), np.random.default_rng(seed)
    steps, slots = contract.layout.steps, 40
    slot_ns, wire = round(steps.slot_s * 1e9), SimulatedBus(1_000_000, None)
    offset_ns = np.array([US * slot_offset_us(contract, node) for node in contract.on_bus(0)])
    sent = frames(slots * nodes)
    sent["can_id"], sent["length"] = 0x181 + np.tile(np.arange(nodes), slots), 8
    sent["data"][:, :8] = random.choice([0, 255, 85, 170], (len(sent), 8))
    begun = np.repeat(slot_ns * np.arange(slots), nodes) + np.tile(offset_ns, slots)
    sent["time_ns"] = begun + random.integers(0, MS, len(sent)) * random.integers(0, 2)
    syncs = frames(slots)
    syncs["can_id"], syncs["length"], syncs["time_ns"] = (
        0x80,
        1,
        round(contract.layout.sync.period_s * 1e9) * np.arange(slots),
    )
    stations = [wire.attach(f"board {each}", slots) for each in range(nodes)]
    gateway = wire.attach("gateway", slots)
    wire.submit(gateway, syncs)
    for each, station in enumerate(stations):
        wire.submit(station, sent[each::nodes])
    ended = wire.run_until(slots * slot_ns).frames
    for each, bound in enumerate(bound_us(contract)):
        mine = ended["time_ns"][ended["can_id"] == 0x181 + each]
        waited_us = (mine - sent["time_ns"][each::nodes][: len(mine)]) / US
        assert waited_us.max() <= bound


def test_a_plan_of_slots_is_that_of_its_frames() -> None:
    """Two nodes with a frame of 8 bytes in 5 ms: 135 bits at most; SYNC ten times and two heartbeats a second."""
    (planned,) = plan(contract_of(2, names=["arm"]), is_touched=False)
    idle = 12 * 58e-6
    assert (planned.name, planned.frames_per_cycle, planned.bits_per_cycle_worst, planned.problems) == (
        "arm",
        2,
        270,
        [],
    )
    assert planned.load_worst == pytest.approx(200 * 270e-6 + 12 * 65e-6)
    assert planned.load_random == pytest.approx(planned.bits_per_cycle_random * 200e-6 + idle, abs=1e-5)
    # A check every 480 slots.
    assert planned.load_rest == pytest.approx(planned.bits_per_cycle_random * 200e-6 / 480 + idle, abs=1e-5)
    assert planned.load_touched is None
    assert (planned.window_ms, planned.window_needed_ms) == (5.0, pytest.approx(0.1 + 0.335))
    assert planned.late_random_ms == pytest.approx(0.1 + 0.135 + 0.065 + 0.1142, abs=0.02)
    # Twice 20 slots of two frames and a heartbeat of each.
    assert planned.receive_buffer_frames == 2 * 20 * 2 + 2
    assert cycle_hz(contract_of(2).layout) == 200


def test_slots_have_to_fit_where_every_board_sends_in_each() -> None:
    (full,) = plan(contract_of(40, quiet=0.0, names=["arm"]), is_touched=False)
    (problem,) = full.problems
    assert problem.startswith(f"arm: 40 nodes in slots of 0.005 s ask for {full.load_worst:.1%} of the bus")
    assert problem.endswith("expected `steps.slot_s` of 0.0054 s or more, or 36 nodes on the bus")
    assert plan(contract_of(36, quiet=0.0), is_touched=False)[0].problems == []
    # Boards above a quiet of 0 leave slots out.
    told = plan(contract_of(40), is_touched=False)[0]
    assert (told.problems, told.window_needed_ms, told.load_worst > 1) == ([], None, True)


def test_a_touch_is_simulated_once_for_buses_that_are_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, float]] = []

    def send(_contract: Contract, bus: int, touch: object, seconds: float) -> Frames:
        assert touch == "objects 0"
        asked.append((bus, seconds))
        sent = frames(1000)
        sent["can_id"], sent["length"] = 0x2AA, 1
        sent["data"][:, 0] = 0x55
        return sent

    monkeypatch.setattr("nodes.steps.simulated.touched_frames", send)
    monkeypatch.setattr(planning, "load_objects", lambda _layout, *, seed: f"objects {seed}")
    contract = contract_of(1, 1, 2)
    plans = plan(contract)
    assert asked == [(0, 16.0)]
    more = touched_load(contract, 1)
    assert more == pytest.approx(1000 * 57e-6 / 16, rel=0.05)
    assert [each.load_touched for each in plans] == pytest.approx(
        [more + 58e-6 * (10 + n) for n in (1, 1, 2)], rel=1e-3
    )


@pytest.mark.heavy
def test_the_load_of_a_touch_is_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "TOUCHED_S", 2.0)
    # The first object presses: a few percent of the bus, and far from full.
    assert 0.0036 < touched_load(Contract.from_layout(load_layout(Path("steps"))), 2) < 0.2
