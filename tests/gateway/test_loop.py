"""The gateway's loop in the company of nodes: SYNC and cycles, what a cycle waits for, and the counters."""

from itertools import count

import numpy as np
import pytest

from dbc import indices as od
from dbc.canopen import HEARTBEAT_BASE, SDO_RESPONSE_BASE, SYNC_COB_ID, NmtCommand, NmtState
from dbc.contract import Contract
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import ECHO
from gateway.loop import LOOK_PERIOD_S
from nodes.segment import Boards
from nodes.virtual_boards import VirtualBoards
from tests.layouts import buses, small_contract
from tests.world import PERIOD_S, STEP_S, EndOfWire, World, valid


def is_sum(each: np.void) -> bool:
    return 0x180 <= each["can_id"] < 0x580


def cut(world: World, bus: int, node_id: int) -> None:
    """Let the gateway hear nothing of a node any more."""
    wire = world.wires[bus]
    wire.loses = lambda end, each: bool(
        end is wire.gateway
        and not each["flags"] & ECHO
        and each["can_id"] & 0x7F == node_id
        and each["can_id"] != SYNC_COB_ID
    )


def test_frames_that_are_read_after_the_next_sync_was_sent_still_count(world: World) -> None:
    """The host gets to read a bus one and a half periods late."""
    first = len(world.measured)
    world.wires[1].gateway.is_held = True
    world.until_sync()
    world.until_sync()
    assert world.gateway.in_flight == 2
    assert len(world.measured) == first
    world.wires[1].gateway.is_held = False
    world.step()
    assert world.gateway.in_flight == 0
    assert [valid(each).all() for each in world.measured[first:]] == [True, True]
    assert not any(world.wrong_blocks(each) for each in world.measured[first:])


def test_cycle_is_closed_before_its_slot_is_opened_again(world: World) -> None:
    """A bus shows no SYNC, and the loop comes to nothing but to send the next."""
    gateway = world.gateway
    world.wires[1].gateway.takes = False
    closed = []
    for _ in range(4):
        due_s = gateway.sync.due_s
        closed.append([each.cycle for each in gateway.send_sync(due_s + 1e-6)])
        assert gateway.in_flight <= 2
    newest = gateway.sync.sent
    assert closed == [[], [], [newest - 3], [newest - 2]]


def test_open_cycle_ends_though_no_bus_shows_the_next_sync(world: World) -> None:
    world.until_sync()
    for wire in world.wires:
        wire.gateway.is_held = True
    world.until_sync()
    sync_s = world.gateway.sync.due_s - PERIOD_S
    world.gateway.sync.stop()
    assert world.gateway.measurements(sync_s + 1.89 * PERIOD_S) == []
    (closed,) = world.gateway.measurements(sync_s + 1.91 * PERIOD_S)
    assert not valid(closed).any()
    assert world.gateway.in_flight == 0


def test_status_counts_closed_cycles_complete_cycles_and_skipped_syncs(world: World) -> None:
    wire = world.wires[0]
    wire.loses = lambda end, each: bool(end is wire.gateway and each["can_id"] in {0x181, 0x381})
    world.until_sync()
    wire.loses = None
    world.run(3 * PERIOD_S)
    before = world.status()
    assert before.cycles == len(world.measured)
    assert before.cycles_complete == sum(bool(valid(each).all()) for each in world.measured) == before.cycles - 1
    world.wires[0].gateway.is_held = True
    world.until_sync()
    assert world.gateway.in_flight == 1
    assert world.status().cycles == before.cycles
    world.wires[0].gateway.is_held = False
    world.step()
    assert world.status().cycles == before.cycles + 1
    assert world.status().cycles_complete == before.cycles_complete + 1
    world.now_s += 3 * PERIOD_S
    world.step()
    assert world.status().syncs_skipped - before.syncs_skipped in {3, 4}
    assert world.status().sync_rate_hz == pytest.approx(world.gateway.sync.rate_hz(world.now_s))


def test_missing_and_late_frames_are_told_of_the_node(world: World) -> None:
    wire = world.wires[1]
    before = world.status()
    wire.loses = lambda end, each: bool(end is wire.gateway and is_sum(each) and each["can_id"] & 0x7F == 2)
    world.until_sync()
    wire.loses = None
    world.until_sync()
    after = world.status()
    assert (after.buses[1].missing, after.buses[1].late) == ([0, before.buses[1].missing[1] + 2], [0, 0])
    assert (after.frames.missing - before.frames.missing, after.frames.late) == (2, 0)
    world.step()
    burst = [each for each in wire.log if each[0] in {0x181, 0x381}]
    wire.put(*burst[-1])  # once more, when its cycle is closed
    world.step()
    assert world.status().buses[1].late == [1, 0]
    assert world.status().buses[0].late == [0, 0]
    assert world.status().frames.late == 1


def test_node_is_awaited_from_its_start_on(small: Contract) -> None:
    """Its first frames count though the gateway looks at heartbeats only now and then."""
    world = World(small)
    cut(world, 1, 2)
    world.run(3.5 + SILENT_AFTER_S)
    assert world.gateway.gathering.collector.expected.tolist() == [True, True, True, False]
    world.wires[1].loses = None
    world.segments[1].boards.nodes[1].boot(world.now_s)
    while not world.gateway.masters[1].nodes[2].in_use:
        world.step()
        awaited, trusted = world.gateway.gathering.collector.expected[3], world.gateway.masters[1].nodes[2].in_use
        assert awaited or not trusted


def test_sync_waits_three_seconds_at_most_for_a_board_that_is_slow_to_prove(small: Contract) -> None:
    """It has no signature, and every first answer to a question is lost: 0.3 s for each object."""
    world = World(small)
    start_s, answers = world.now_s, count()

    def loses(end: EndOfWire, each: np.void) -> bool:
        if end is not world.wires[0].gateway or each["can_id"] != SDO_RESPONSE_BASE + 1:
            return False
        if int.from_bytes(each["data"][1:3].tobytes(), "little") == od.SIGNATURE:
            each["data"][4:8] = 0
        return next(answers) % 2 == 0

    world.wires[0].loses = loses
    while not world.measured:
        world.step()
        assert world.now_s < start_s + 3.5
    assert world.now_s > start_s + 3.0
    assert valid(world.measured[-1]).tolist() == [False, True, True, True]
    assert "bus0: no answer yet from node 1" in world.lines


def test_no_cycle_waits_for_a_node_that_is_gone(world: World) -> None:
    cut(world, 0, 1)
    world.until_sync()
    assert world.gateway.in_flight == 1
    world.run(SILENT_AFTER_S + 2 * LOOK_PERIOD_S)
    assert world.gateway.gathering.collector.expected.tolist() == [False, True, True, True]
    for _ in range(4):
        world.until_sync()
        assert world.gateway.in_flight == 0


def test_node_that_sends_sums_is_awaited_though_its_heartbeat_is_lost(world: World) -> None:
    wire = world.wires[0]
    wire.loses = lambda end, each: bool(end is wire.gateway and each["can_id"] == HEARTBEAT_BASE + 1)
    for _ in range(round((SILENT_AFTER_S + 2.0) / STEP_S)):
        world.step()
        assert world.gateway.gathering.collector.expected.all()
    assert any("silent" in line for line in world.lines)


def test_all_blocks_of_a_node_are_used_and_given_up_together() -> None:
    world = World(small_contract(bus=buses(1, 1, blocks_per_node=2)))
    world.until_whole(2.0)
    world.nmt(0, NmtCommand.STOP, 1)
    came = world.run(4 * PERIOD_S)
    assert [False, False, True, True] in [valid(each).tolist() for each in came]
    world.until_whole(1.0)
    assert not any(world.wrong_blocks(each) for each in world.measured)


def test_skin_of_can_fd_becomes_whole() -> None:
    world = World(small_contract(bus=buses(1, 1, blocks_per_node=2, fd=True, data_bitrate=4_000_000)))
    world.until_whole(2.0)
    came = world.run(1.0)
    assert all(valid(each).all() and not world.wrong_blocks(each) for each in came)
    counts = world.status().frames
    assert (counts.missing, counts.malformed, counts.late) == (0, 0, 0)


def test_analogue_sums_at_the_end_of_their_converter_are_not_usable() -> None:
    world = World(small_contract(taxels={"frontend": "analogue"}))
    world.until_whole(2.0)
    found = set()
    for each in world.run(1.0):
        sums = np.frombuffer(each.sums, "<i4")
        usable = np.frombuffer(each.usable, np.uint8) != 0 if each.usable else np.ones(sums.size, np.bool_)
        np.testing.assert_array_equal(usable, sums < 511 * 32)
        found |= set(usable.tolist())
    assert found == {False, True}


@pytest.mark.parametrize("unnumbered", [True, False])
def test_absent_nodes_are_asked_once_for_boards_without_node_id(unnumbered: bool) -> None:
    class Fresh(World):
        def new_boards(self, bus: int, contract: Contract) -> Boards:
            return VirtualBoards(contract, bus, {1} if bus or unnumbered else (), self.hardware, unnumbered=not bus)

    world = Fresh(small_contract())
    world.run(5.0)
    fresh = "bus0: boards without node-ID are there: stop the gateway, and run skin commission"
    assert world.lines.count(fresh) == unnumbered
    assert [can_id for can_id, _ in world.wires[0].log].count(0x7E5) == 1
    assert world.segments[1].boards.nodes[0].state == NmtState.OPERATIONAL
