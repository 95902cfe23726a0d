"""The gateway's loop without nodes: what it sends, when, in which order, and what it tells."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import cast

import numpy as np
import pytest

from bus.link import Send, State
from canskin.messages import FrameCounts, Measurement
from dbc.contract import Contract, NodeContract
from dbc.frame import ECHO, ERROR, Frames, frames
from gateway.gathering import Gathering, Health, Sync
from gateway.load import LoadMeter
from gateway.loop import GatewayLoop
from gateway.nmt_master import NmtMaster
from tests import messages as make
from tests.bus.harness import frame


@dataclass
class Told:
    """A gathering that keeps what it is told, and returns what the test says."""

    published: int = 7
    complete: int = 5
    counts: FrameCounts = field(default_factory=lambda: FrameCounts(accepted=3))
    in_flight: int = 2
    due_s: float = 300.0
    may_sleep_until_s: float = 250.0
    disturbance: str = "what it does"
    foreign: dict[int, int] = field(default_factory=dict)
    made: list[Measurement] = field(default_factory=list)
    calls: list[str] = field(default_factory=list)
    syncs: list[Sync] = field(default_factory=list)
    proofs: list[tuple[int, int, bool]] = field(default_factory=list)

    def trust(self, node: NodeContract, *, proven: bool) -> None:
        self.proofs.append((node.bus, node.node_id, proven))

    def take(self, bus: int, arrived: Frames, health: Health, now_s: float) -> None:
        self.calls.append(f"take {len(arrived)} of {bus} at {now_s:g}, gap {health.has_gap}, {health.stamp_error_ns}")

    def begin(self, sync: Sync) -> list[Measurement]:
        self.syncs.append(sync)
        return self.made

    def tick(self, now_s: float) -> None:
        self.calls.append(f"tick at {now_s:g}")

    def measurements(self, now_s: float, wall_offset_ns: int) -> list[Measurement]:
        self.calls.append(f"measure at {now_s:g}, {wall_offset_ns}")
        return self.made

    def look(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        self.calls.append(f"look at {now_s:g}, buses {[*masters]}")

    def take_foreign_syncs(self, bus: int) -> int:
        return self.foreign.pop(bus, 0)

    def missing_and_late(self, place: int) -> tuple[int, int]:
        return 10 + place, 20 + place


class Alone:
    """A loop that began at 100 s, with the frames that it has sent."""

    def __init__(self, contract: Contract) -> None:
        self.sent: list[tuple[int, np.void]] = []
        self.takes = [1, 1]
        self.lines: list[str] = []
        self.complaints: list[str] = []
        self.loop = GatewayLoop(
            contract,
            {bus: self._sender(bus) for bus in (0, 1)},
            100.0,
            say=self.lines.append,
            complain=self.complaints.append,
        )
        self.told = Told()
        self.loop.gathering = cast("Gathering", self.told)

    def _sender(self, bus: int) -> Send:
        def send(burst: Frames) -> int:
            self.sent += [(bus, each) for each in burst.copy()]
            return self.takes[bus]

        return send

    def taken(self) -> list[tuple[int, int, bytes]]:
        """Return bus, identifier and data of what was sent since the last call."""
        sent, self.sent = self.sent, []
        return [(bus, int(each["can_id"]), each["data"][: each["length"]].tobytes()) for bus, each in sent]

    def until_sync(self) -> float:
        """Tick until SYNC is due at a time; return that time of the first tick after which it is."""
        now_s = 100.0
        while not self.loop.sync.runs:
            now_s += 0.01
            self.loop.tick(now_s)
            assert now_s < 105
        return now_s

    def refuse(self, bus: int, *, syncs: int) -> None:
        self.takes[bus] = 0
        for _ in range(syncs):
            self.loop.send_sync(self.loop.sync.due_s)
        self.takes[bus] = 1


@pytest.fixture
def alone(small: Contract) -> Alone:
    return Alone(small)


def test_sync_begins_a_tenth_of_a_second_after_the_last_node_has_had_its_chance(alone: Alone) -> None:
    """A node that has never been heard is asked once, and its answer is waited for 0.3 s."""
    started_s = alone.until_sync()
    assert started_s == pytest.approx(100.01 + 0.3, abs=0.02)
    assert alone.loop.sync.due_s == started_s + 0.1
    assert alone.lines == ["bus0: no answer yet from nodes 1-2", "bus1: no answer yet from nodes 1-2"]


def test_sync_that_was_stopped_does_not_begin_again(alone: Alone) -> None:
    alone.until_sync()
    alone.loop.send_sync(alone.loop.sync.due_s)
    alone.loop.sync.stop()
    alone.loop.tick(110.0)
    assert not alone.loop.sync.runs


def test_patience_counts_from_the_first_tick_and_lasts_three_seconds(
    alone: Alone, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(NmtMaster, "passed", False)
    for now_s in (150.0, 152.999):
        alone.loop.tick(now_s)
        assert not alone.loop.sync.runs
    alone.loop.tick(153.0)
    assert alone.loop.sync.due_s == 153.1


def test_every_bus_has_to_have_passed(alone: Alone, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(NmtMaster, "passed", property(lambda master: master is alone.loop.masters[1]))
    alone.loop.tick(150.0)
    assert not alone.loop.sync.runs


def test_a_sync_goes_to_every_bus_with_the_times_of_its_turn(alone: Alone) -> None:
    alone.loop.sync.start(120.0)
    assert alone.loop.send_sync(119.999, 17) == []
    assert (alone.told.syncs, alone.taken()) == ([], [])
    alone.told.made = [make.measurement(3)]
    assert alone.loop.send_sync(120.02, 17) == [make.measurement(3)]
    (sync,) = alone.told.syncs
    assert (sync.number, sync.counter, sync.wall_offset_ns, sync.period_s) == (1, 1, 17, 0.05)
    assert (sync.due_ns, sync.sent_ns) == (120_000_000_000, 120_020_000_000)
    assert [bus for bus, _ in alone.sent] == [0, 1]
    for _, each in alone.sent:
        assert (each["can_id"], each["length"]) == (0x80, 0)  # this skin's SYNC has no counter
        assert each["time_ns"] == 120_000_000_000
        assert each["expires_ns"] == 120_025_000_000  # half a period later the next is too near
    alone.loop.send_sync(120.05)
    assert (alone.told.syncs[1].number, alone.told.syncs[1].counter, alone.told.syncs[1].wall_offset_ns) == (2, 2, 0)


def test_what_is_due_next_is_a_sync_or_a_measurement(alone: Alone) -> None:
    assert (alone.loop.due_s, alone.loop.may_sleep_until_s) == (300.0, 250.0)
    alone.loop.sync.start(200.0)
    assert (alone.loop.due_s, alone.loop.may_sleep_until_s) == (200.0, 200.0)
    assert alone.loop.in_flight == 2


def test_frames_and_losses_go_to_the_gathering_and_an_empty_look_does_not(alone: Alone) -> None:
    alone.loop.take(1, frames(0), 101.0, stamp_error_ns=5)
    assert alone.told.calls == []
    alone.loop.take(1, np.concatenate([frame(0x181)] * 3), 102.0, stamp_error_ns=5)
    alone.loop.take(0, frames(0), 103.0, dropped=2, stamp_error_ns=None)
    alone.loop.take(0, frames(0), 104.0, dropped=2, stamp_error_ns=None)
    alone.loop.take(0, frame(0x181), 105.0, state=State.BUS_OFF, dropped=2, stamp_error_ns=None)
    assert alone.told.calls == [
        "take 3 of 1 at 102, gap False, 5",
        "take 0 of 0 at 103, gap True, None",
        "take 1 of 0 at 105, gap True, None",
    ]


def test_the_gathering_hears_of_a_doubt_before_the_frames_behind_it(alone: Alone) -> None:
    node = alone.loop.masters[1].nodes[2]
    node.trusted = True
    alone.told.trust = lambda node, *, proven: alone.told.calls.append(f"{node.bus} {node.node_id} {proven}")  # type: ignore[method-assign]
    alone.loop.take(1, np.concatenate([frame(0x702, b"\0"), frame(0x182)]), 102.0, stamp_error_ns=None)
    assert alone.told.calls == ["1 2 False", "take 2 of 1 at 102, gap False, None"]


def test_nodes_are_looked_after_five_times_a_second(alone: Alone) -> None:
    for now_s in (100.0, 100.1, 100.199, 100.201, 100.3, 100.402):
        alone.loop.tick(now_s)
    ticks = [each for each in alone.told.calls if each.startswith("tick")]
    looks = [each for each in alone.told.calls if each.startswith("look")]
    assert len(ticks) == 6
    assert looks == [f"look at {now_s}, buses [0, 1]" for now_s in ("100", "100.201", "100.402")]


def test_emergencies_and_other_sync_producers_are_told_once(alone: Alone) -> None:
    alone.loop.take(1, frame(0x82, bytes.fromhex("3081110000000000")), 100.0, stamp_error_ns=None)
    alone.loop.take(1, frame(0x81, bytes.fromhex("10ff810000000000")), 100.0, stamp_error_ns=None)
    alone.told.foreign = {0: 2}
    alone.loop.tick(100.0)
    told = [
        "another SYNC producer on bus0: what it does",
        "EMCY 8130h from node 2 on bus1",
        "EMCY FF10h from node 1 on bus1",
    ]
    assert alone.complaints == told
    alone.loop.tick(101.0)
    assert alone.complaints == told


def test_stop_commands_the_nodes_of_every_bus_to_pre_operational(alone: Alone) -> None:
    alone.loop.stop()
    assert alone.taken() == [(0, 0, b"\x80\0"), (1, 0, b"\x80\0")]


# SYNCs that a bus does not take


WHY = {
    State.ACTIVE: "its transmit queue is full: is the bus overloaded?",
    State.WARNING: "its transmit queue is full: is the bus overloaded?",
    State.PASSIVE: "nobody acknowledges its frames: is any node powered, wired and at the same bit rate?",
    State.BUS_OFF: "the controller is bus-off: wiring, termination or bit rate",
    State.LOST: "the connection to the bus is gone",
}


@pytest.mark.parametrize("state", State)
def test_a_refused_sync_is_explained_by_the_state_of_its_controller(alone: Alone, state: State) -> None:
    alone.loop.sync.start(120.0)
    alone.loop.explain_refused_syncs(dict.fromkeys((0, 1), State.ACTIVE))
    assert alone.lines == []
    alone.refuse(1, syncs=2)
    for _ in range(2):
        alone.loop.explain_refused_syncs({0: State.ACTIVE, 1: state})
    assert alone.lines == [f"bus1 takes no SYNC: {WHY[state]}"]
    alone.loop.send_sync(alone.loop.sync.due_s)
    assert alone.lines[1:] == ["bus1 takes SYNC again, after 2 that it did not take"]
    alone.loop.send_sync(alone.loop.sync.due_s)
    alone.loop.explain_refused_syncs({0: State.ACTIVE, 1: state})
    assert len(alone.lines) == 2


def test_a_bus_that_refuses_again_is_explained_again(alone: Alone) -> None:
    alone.loop.sync.start(120.0)
    states = dict.fromkeys((0, 1), State.LOST)
    for _ in range(2):
        alone.refuse(0, syncs=1)
        alone.loop.explain_refused_syncs(states)
        alone.loop.send_sync(alone.loop.sync.due_s)
        alone.loop.explain_refused_syncs(states)
    gone = "bus0 takes no SYNC: the connection to the bus is gone"
    assert alone.lines == [gone, "bus0 takes SYNC again, after 1 that it did not take"] * 2


# What is counted


def test_status_tells_of_cycles_syncs_links_and_nodes(alone: Alone) -> None:
    alone.loop.sync.start(120.0)
    alone.loop.send_sync(120.0)
    alone.loop.send_sync(120.25)  # four of five are skipped
    status = alone.loop.status({0: (State.ACTIVE, 4), 1: (State.BUS_OFF, 6)}, 121.0)
    assert (status.cycles, status.cycles_complete, status.frames.accepted) == (7, 5, 3)
    assert (status.syncs_skipped, status.sync_rate_hz) == (4, 2.0)
    assert [(bus.name, bus.link, bus.overrun) for bus in status.buses] == [
        ("bus0", "active", 4),
        ("bus1", "bus_off", 6),
    ]
    assert [(bus.missing, bus.late) for bus in status.buses] == [([10, 11], [20, 21]), ([12, 13], [22, 23])]
    assert [(bus.nodes, bus.refused, bus.emcy) for bus in status.buses] == [([1, 2], [], [0, 0])] * 2
    assert status.state == ""


def test_the_load_of_a_bus_counts_from_the_first_sync_on(alone: Alone) -> None:
    busy = np.concatenate([frame(0x555, b"\x55" * 8, ECHO)] * 100)
    links = dict.fromkeys((0, 1), (State.ACTIVE, 0))
    alone.loop.take(0, busy, 100.0, stamp_error_ns=None)
    started_s = alone.until_sync()
    alone.loop.take(1, busy, started_s, stamp_error_ns=None)
    alone.loop.take(1, frame(0x555, b"\x55" * 8, ECHO | ERROR), started_s, stamp_error_ns=None)
    status = alone.loop.status(links, started_s + 1.1)  # a second after the first SYNC
    assert status.buses[0].load_ratio == status.buses[0].mean_load_ratio == 0.0
    assert status.buses[1].load_ratio == status.buses[1].mean_load_ratio == pytest.approx(111e-4, rel=0.05)
    status = alone.loop.status(links, started_s + 2.1)
    assert status.buses[1].load_ratio == 0.0
    assert status.buses[1].mean_load_ratio == pytest.approx(55.5e-4, rel=0.05)


def test_loads_are_added_up_in_turn_after_measurements(alone: Alone, monkeypatch: pytest.MonkeyPatch) -> None:
    """One bus at a time, and not more often than every 20 ms."""
    added: list[tuple[int, str]] = []
    now_ms = [0]
    monkeypatch.setattr(LoadMeter, "account", lambda load: added.append((now_ms[0], load._wires.name)))
    for made, times_ms in (([], (5, 50)), ([make.measurement(1)], (100, 115, 119, 121, 135, 141, 161, 300))):
        alone.told.made = made
        for now_ms[0] in times_ms:
            assert alone.loop.measurements(100 + now_ms[0] / 1000, 9) == made
    assert added == [(100, "bus1"), (121, "bus0"), (141, "bus1"), (161, "bus0"), (300, "bus1")]
    assert alone.told.calls[0] == "measure at 100.005, 9"
    alone.loop.measurements(101.0)
    assert alone.told.calls[-1] == "measure at 101, 0"
