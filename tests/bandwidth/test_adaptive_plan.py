"""The plan of adaptive buses, figure by figure.

SYNC has a counter in one byte: 65 bits at most, as a heartbeat; 58 without data that asks for more stuff bits. A frame
of sums has 8 bytes: 135 bits at most and 111 without stuff bits. A group sends one in each millisecond at most.
"""

from typing import Any

import numpy as np
import pytest

from bandwidth import adaptive_plan
from bandwidth.adaptive_plan import plan_adaptive, touched_load
from bandwidth.plan import milliseconds
from bandwidth.traffic import Disturbance
from canskin.errors import InputError
from dbc.contract import Contract
from dbc.frame import Frames, frames
from tests.layouts import ADAPTIVE, buses, small_layout

BUSES = [{"name": "arm", "nodes": 1}, {"name": "hand", "nodes": 1, "bitrate": 250_000}]
CONTRACT = Contract.from_layout(small_layout(**ADAPTIVE, bus=BUSES))


def test_loads_are_those_of_idle_and_of_busy_groups() -> None:
    fast, slow = plan_adaptive(CONTRACT, is_touched=False)
    assert [(each.name, each.nodes, each.bitrate) for each in (fast, slow)] == [
        ("arm", 1, 1_000_000),
        ("hand", 1, 250_000),
    ]
    assert fast.load_idle == pytest.approx(11 * 58e-6)
    assert fast.load_idle_worst == pytest.approx(11 * 65e-6)
    assert slow.load_idle_worst == pytest.approx(11 * 65e-6 * 4)
    assert fast.load_worst == pytest.approx(4 * 1000 * 135e-6 + 11 * 65e-6)
    assert slow.load_worst == 1
    # 7.4 and 1.8 frames fill a millisecond.
    assert (fast.groups_fill, slow.groups_fill) == (8, 2)
    assert (fast.load_touched, fast.budget, fast.problems) == (None, None, [])


def test_a_receiver_keeps_two_periods_of_sync_of_the_shortest_frames() -> None:
    fast, slow = plan_adaptive(CONTRACT, is_touched=False)
    assert (fast.receive_buffer_frames, slow.receive_buffer_frames) == (1802, 451)  # 200 ms of 111 and of 444 us
    assert (fast.receive_buffer_bytes, slow.receive_buffer_bytes) == (1802 * 896, 451 * 896)


def test_a_budget_of_80_percent_is_what_is_left_of_the_bus_for_each_node() -> None:
    fast, slow = plan_adaptive(CONTRACT, is_touched=False)
    assert (fast.budget_80_bits_per_s, slow.budget_80_bits_per_s) == (800_000 - 11 * 65, 200_000 - 11 * 65)


def test_a_budget_is_what_all_nodes_send() -> None:
    fast, slow = plan_adaptive(CONTRACT, is_touched=False, budget_bits_per_s=100_000)
    assert fast.budget is not None
    assert slow.budget is not None
    assert fast.budget.bits_per_s == 100_000
    assert fast.budget.load == pytest.approx(0.1 + 11 * 65e-6)
    assert slow.budget.load == pytest.approx(0.4 + 11 * 260e-6)
    (most, _) = plan_adaptive(CONTRACT, is_touched=False, budget_bits_per_s=2_000_000)
    assert most.budget is not None
    assert most.budget.load == 1
    assert most.budget.full_ms is None


def test_times_are_those_of_the_slowest_node() -> None:
    fast, slow = plan_adaptive(CONTRACT, is_touched=False)
    (node,) = fast.node_plans
    assert (node.node_id, node.coarse_ms, node.heartbeat_response_ms) == (
        1, fast.coarse_ms, fast.heartbeat_response_ms
    )  # fmt: skip
    assert fast.heartbeat_response_ms is not None
    assert slow.heartbeat_response_ms is None
    assert slow.problems == ["hand: the pauses after SYNC have no room for all SDO transfers and heartbeats"]


def test_a_full_bus_says_how_many_nodes_would_do() -> None:
    """Eight nodes of 4 frames of 5.4 ms on 25 kbit/s: 172.8 ms of frames in a patience of 24 ms."""
    (full,) = plan_adaptive(
        Contract.from_layout(small_layout(16, 16, **ADAPTIVE, bus=buses(8, names=["leg"], bitrate=25_000))),
        allowed=Disturbance(sdo_per_s=0.0),
        is_touched=False,
    )
    assert full.coarse_ms is None
    assert full.problems[0] == (
        "leg: coarse sums have no bound while everything moves: 8 nodes send for 172.8 ms what has waited for 24 ms; "
        "1 nodes or a higher bit rate would do"
    )
    assert full.sdo_response_ms is None


class Touch:
    """A simulation that the test makes up: 1000 frames of sums on every bus."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, float]] = []

    def __call__(self, _contract: Contract, bus: int, touch: object, seconds: float) -> Frames:
        assert touch == "objects 0"
        self.asked.append((bus, seconds))
        sent = frames(1000)
        sent["can_id"], sent["length"] = 0x2AA, 1
        sent["data"][:, 0] = 0x55
        return sent


@pytest.fixture
def touch(monkeypatch: pytest.MonkeyPatch) -> Touch:
    touch = Touch()
    monkeypatch.setattr(adaptive_plan, "load_sender", lambda name: touch if name == "adaptive" else None)
    monkeypatch.setattr(adaptive_plan, "load_objects", lambda _layout, *, seed: f"objects {seed}")
    return touch


def test_a_touch_of_16_seconds_is_simulated_once_for_buses_that_are_alike(touch: Touch) -> None:
    bus = [*BUSES, {"name": "foot", "nodes": 2}]
    contract = Contract.from_layout(small_layout(8, 16, **ADAPTIVE, bus=bus))
    plans = plan_adaptive(contract)
    assert sorted(touch.asked) == [(0, 16.0), (1, 16.0)]
    # 34 + 8 bits, 13 of the end, and what stuff bits they have: the same in each of 1000 frames.
    bits = round((plans[0].load_touched or 0) * 16e6 / 1000 - plans[0].load_idle * 16e3)
    assert 55 <= bits <= 60
    assert touched_load(contract, 0) == pytest.approx(bits * 1000e-6 / 16)
    assert touched_load(contract, 1) == pytest.approx(bits * 4000e-6 / 16)
    loads = [each.load_touched for each in plans]
    assert loads == pytest.approx(
        [plan.load_idle + bits * x * 1e-3 / 16 for plan, x in zip(plans, (1, 4, 1), strict=True)]
    )


def test_without_a_package_that_simulates_there_is_no_touched_load(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_name: str) -> Any:
        raise InputError("not installed")

    monkeypatch.setattr(adaptive_plan, "load_sender", fail)
    assert touched_load(CONTRACT, 0) is None
    assert [each.load_touched for each in plan_adaptive(CONTRACT)] == [None, None]


def test_figures_without_a_bound_are_left_out() -> None:
    told = milliseconds
    assert told(np.array([1_500_000, 250_000])) == pytest.approx(1.5)
    assert told(1) == pytest.approx(1e-6)
    assert told(0) is None
    assert told(np.zeros(0, np.int64)) is None
