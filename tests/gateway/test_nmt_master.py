"""Nodes that leave OPERATIONAL, whatever took them out, and how they come back."""

import numpy as np
import pytest

from canskin.messages import SILENT, Fault, NodeFault
from dbc.canopen import (
    EMCY_BASE,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    NmtCommand,
    NmtState,
)
from dbc.configuration import DIALOGUES, TICK_S
from dbc.contract import Contract
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE
from gateway.batch import batch_of
from gateway.loop import LOOK_PERIOD_S
from gateway.nmt_master import NmtMaster
from gateway.node_machine import PAUSES_S
from gateway.sdo import TIMEOUT_S
from tests.bus.harness import frame
from tests.gateway.boards import SdoServer
from tests.layouts import buses, small_contract, small_layout
from tests.world import FOREVER_NS, PERIOD_S, STEP_S, EndOfWire, World, swap_mapping, valid

HEARTBEAT_S = 1.0
#: From the event that tells that a node is out to its first valid block: a pause, a proof, a cycle to start in.
SOON_S = PAUSES_S[0] + 3 * PERIOD_S


def state_of(world: World, bus: int, node_id: int) -> NmtState:
    return next(node.state for node in world.segments[bus].boards.nodes if node.contract.node_id == node_id)


def test_a_stray_command_to_all_costs_the_nodes_of_its_bus_a_moment(world: World) -> None:
    world.nmt(0, NmtCommand.STOP, 0)
    came = world.run(3 * PERIOD_S)
    assert not all(valid(each)[1] for each in came)
    world.until_whole(SOON_S)
    world.run(0.5)
    went, back = world.lines
    assert went == "nodes 1-2 on bus0 left OPERATIONAL: stopped, by another master's NMT command [node-left]"
    assert back.startswith("nodes 1-2 on bus0 back after 0.")


def test_lost_start_command(small: Contract) -> None:
    world, lost = World(small), list[int]()

    def loses(end: EndOfWire, each: np.void) -> bool:
        is_start = each["can_id"] == NMT_COB_ID and bytes(each["data"][:2]) == bytes((NmtCommand.START, 2))
        if is_start and end is end.wire.nodes and not lost:
            lost.append(1)
            return True
        return False

    world.wires[0].loses = loses
    world.run(0.5)
    assert lost
    assert state_of(world, 0, 2) is NmtState.PRE_OPERATIONAL
    world.until_whole(HEARTBEAT_S + SOON_S)


def test_silent_node_is_said_once_and_comes_back(world: World) -> None:
    """The wire to the node is cut, not its process: it goes on by itself meanwhile."""
    wire = world.wires[0]
    wire.loses = lambda end, each: bool(end is wire.gateway and not each["flags"] & ECHO)
    world.run(SILENT_AFTER_S + 0.3)
    assert not valid(world.measured[-1])[:2].any()
    assert valid(world.measured[-1])[2:].all()
    silent = [line for line in world.lines if "silent" in line]
    assert silent == ["nodes 1-2 on bus0 silent: no heartbeat for 1.5 s [node-silent]"]
    assert world.gateway.masters[0].nmt.tolist() == [SILENT, SILENT]
    world.pass_time(20)
    assert [line for line in world.lines if "silent" in line] == silent
    wire.loses = None
    world.until_whole(HEARTBEAT_S + SOON_S)
    world.run(0.5)
    assert any("nodes 1-2 on bus0 back after" in line for line in world.lines)


def test_gateway_that_starts_over_takes_running_nodes(world: World) -> None:
    world.gateway = world.new_gateway()
    world.until_whole(2.0)
    world.run(0.5)
    assert world.lines == []  # no node left, none was silent: it is in since it was proven


def test_gateway_leaves_nodes_pre_operational(world: World) -> None:
    world.gateway.stop()
    world.carry(world.hear)
    assert {node.state for segment in world.segments for node in segment.boards.nodes} == {NmtState.PRE_OPERATIONAL}


def test_absent_nodes_do_not_keep_sync_waiting(small: Contract) -> None:
    world = World(small)
    world.wires[1].loses = lambda end, _: end is world.wires[1].nodes
    taken_s = 0.0
    while not world.measured:
        world.step()
        taken_s += PERIOD_S / 2
        assert taken_s < 3.5
    assert valid(world.measured[-1]).tolist()[2:] == [False, False]
    assert "bus1: no answer yet from nodes 1-2" in world.lines


def test_optional_nodes_come_and_go_and_nothing_is_wrong() -> None:
    """SYNC and complete cycles wait for the other bus alone."""
    world = World(small_contract(bus=[*buses(2), *buses(2, names=["tip"], optional=[1, 2])]))
    wire = world.wires[1]

    def is_away(end: EndOfWire, each: np.void) -> bool:
        return end is wire.nodes or not each["flags"] & ECHO

    wire.loses = is_away
    started_s = world.now_s
    while not world.measured:
        world.step()
    assert world.now_s - started_s < TIMEOUT_S
    world.run(1.0)
    status = world.status()
    assert status.cycles == status.cycles_complete > 0
    assert status.buses[1].faults == dict.fromkeys((1, 2), NodeFault(Fault.AWAY))
    assert world.lines == ["tip: starts without optional nodes 1-2"]
    wire.loses = None
    world.until(lambda: bool(valid(world.measured[-1]).all()))
    wire.loses = is_away
    world.run(2 * SILENT_AFTER_S)
    assert {each.kind for each in world.status().buses[1].faults.values()} == {Fault.AWAY}
    assert world.status().cycles == world.status().cycles_complete


def test_another_sync_producer_is_complained_of_once(world: World) -> None:
    world.wires[1].put(SYNC_COB_ID, bytes((world.gateway.sync.counter + 2,)))
    world.run(3 * LOOK_PERIOD_S)
    (said,) = world.complaints
    assert said.startswith("another SYNC producer on bus1: its cycles are not valid; ")


def test_emergency_of_a_node_is_complained_of(world: World) -> None:
    world.wires[0].put(EMCY_BASE + 1, bytes((0x10, 0xFF, 0x81, 0, 0, 0, 0, 0)))
    world.run(0.5)
    assert world.complaints == ["EMCY FF10h from node 1 on bus0 [node-emergency]"]
    assert world.status().buses[0].emcy == [0xFF10, 0]
    world.wires[0].put(EMCY_BASE + 1, bytes(8))
    world.run(0.5)
    assert world.status().buses[0].emcy == [0, 0]
    first, second = world.status().buses[0].emergencies
    assert [(each.node, each.code) for each in (first, second)] == [(1, 0xFF10), (1, 0)]
    assert second.time_ns - first.time_ns == pytest.approx(0.5e9, abs=2 * STEP_S * 1e9)
    assert world.complaints == ["EMCY FF10h from node 1 on bus0 [node-emergency]"]


def test_answer_that_a_board_gave_before_a_write_and_sends_after_it_proves_nothing(world: World) -> None:
    world.until_whole(2.0)
    node = world.gateway.masters[0].nodes[1]
    answers = world.wires[0].line(SDO_RESPONSE_BASE + 1, 0x7FF)
    answers.shut_until_ns = FOREVER_NS
    world.until(lambda: node.dialogue is not None)
    swap_mapping(world, 0, 1)
    world.until(lambda: node.dialogue is None)
    world.until(lambda: node.dialogue is not None)
    answers.shut_until_ns = 0
    assert not any(world.wrong_blocks(each) for each in world.run(2.0))


def test_questions_that_were_lost_before_a_write_keep_no_node_out(world: World) -> None:
    world.until_whole(2.0)
    node, wire = world.gateway.masters[0].nodes[1], world.wires[0]
    wire.loses = lambda end, each: bool(end is wire.nodes and each["can_id"] == SDO_REQUEST_BASE + 1)
    world.until(lambda: node.dialogue is not None)
    world.until(lambda: node.dialogue is None)
    wire.loses = None
    swap_mapping(world, 0, 1)
    world.step()
    assert not node.in_use
    assert world.until_whole(2.0) < SOON_S + 2 * PERIOD_S
    world.run(0.5)
    assert len(world.lines) == 3, world.lines  # doubted, set right, back
    assert node.tries == 1


def test_absent_nodes_do_not_take_the_turns_of_others() -> None:
    """127 of 128 nodes are not there: the last is asked in its turn, proven, started, and heard."""
    contract = Contract.from_layout(small_layout(64, 64, bus=buses(127, 1)))
    server = SdoServer(contract, contract.on_bus(0)[126])
    answers, started = list[bytes](), list[int]()

    def send(can_id: int, data: bytes) -> None:
        if can_id == SDO_REQUEST_BASE + 127:
            answers.append(server.answer(data))
        elif can_id == NMT_COB_ID and data[0] == NmtCommand.START:
            started.append(data[1])

    master = NmtMaster(contract, 0, send, lambda *_: None, lambda _: None)
    now_s = 0.0
    while not master.passed:
        now_s += TICK_S
        assert now_s < 127 / DIALOGUES * (TIMEOUT_S + 2 * TICK_S)
        master.tick(now_s)
        while answers:
            master.take(frame(SDO_RESPONSE_BASE + 127, answers.pop()), now_s)
    assert started == [127]
    master.take(frame(HEARTBEAT_BASE + 127, b"\5"), now_s)
    assert master.nmt.tolist() == [SILENT] * 126 + [NmtState.OPERATIONAL]


@pytest.mark.parametrize("flags", [ECHO, ECHO | ERROR, ERROR, EXTENDED, REMOTE])
def test_own_extended_remote_and_error_frames_are_no_heartbeats(small: Contract, flags: int) -> None:
    master = NmtMaster(small, 0, lambda *_: None, lambda *_: None, lambda _: None)
    master.take(batch_of(frame(HEARTBEAT_BASE + 1, b"\5", flags), 0, small.table).talk, 0.0)
    assert master.nmt.tolist() == [SILENT, SILENT]
