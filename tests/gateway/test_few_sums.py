"""Fewer sums than blocks: nodes without sums answer by heartbeat alone, and nothing waits for them."""

import pytest

from canskin.messages import SILENT
from dbc.canopen import HEARTBEAT_BASE, SDO_RESPONSE_BASE, NmtCommand, NmtState
from tests.layouts import small_contract
from tests.world import World, valid


@pytest.fixture
def sparse() -> World:
    """Two sums of one block: three of four nodes have none, and the second bus carries none."""
    world = World(small_contract(measurement={"rows": [[1, 3], [1, 6]]}))
    world.until_whole(2.0)
    return world


def test_only_blocks_with_sums_are_valid_and_the_cycle_is_complete(sparse: World) -> None:
    before = sparse.status()
    came = sparse.run(2.0)
    assert {tuple(valid(each).tolist()) for each in came} == {(False, True, False, False)}
    assert not any(sparse.wrong_blocks(each) for each in came)
    after = sparse.status()
    assert after.cycles_complete - before.cycles_complete == after.cycles - before.cycles == len(came)
    assert after.frames.missing == 0
    assert (sparse.gateway.masters[1].nmt == NmtState.OPERATIONAL).all()


def test_node_without_sums_sends_heartbeats_alone(sparse: World) -> None:
    sparse.wires[0].log.clear()
    sparse.pass_time(3.0)
    senders = {can_id for can_id, _ in sparse.wires[0].log}
    assert HEARTBEAT_BASE + 1 in senders
    sums = {int(each) for each in sparse.contract.table.cob_id}
    sparse.run(1.0)
    assert {node.tpdos for node in sparse.contract.nodes if node.block != 1} == {()}
    assert sums & {can_id for can_id, _ in sparse.wires[0].log} == sums


#: What a node without sums sends.
_OF_NODE_2 = HEARTBEAT_BASE + 2, SDO_RESPONSE_BASE + 2


def test_death_of_a_node_without_sums_is_told_and_costs_no_cycle(sparse: World) -> None:
    sparse.wires[1].loses = lambda end, each: end is end.wire.gateway and each["can_id"] in _OF_NODE_2
    came = sparse.run(3.0)
    assert sparse.gateway.masters[1].nmt[1] == SILENT
    assert any("node 2" in line for line in sparse.lines)
    assert all(valid(each)[1] for each in came)


def test_doubt_of_the_node_with_sums_costs_its_block(sparse: World) -> None:
    sparse.nmt(0, NmtCommand.ENTER_PRE_OPERATIONAL, 2)
    sparse.step()
    assert not any(valid(each).any() for each in sparse.run(0.06))
    sparse.until_whole(2.0)
