"""Requests to adaptive nodes: groups again at growing pauses, few nodes at a time, and their noise in turn."""

from itertools import pairwise

import numpy as np
import pytest

from canskin.messages import BlockState
from dbc.canopen import SDO_REQUEST_BASE, SDO_RESPONSE_BASE
from dbc.contract import Contract
from dbc.indices import OD_NODE_NOISE, OD_REFRESH
from gateway.foreign_sdo import ForeignClient
from tests.gateway.boards import BoardWorld, at_rest, lose, states
from tests.layouts import ADAPTIVE, small_layout

#: The times that docs/adaptive.md promises.
PAUSES_S = (0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0)


def test_request_that_is_not_answered_is_repeated_at_growing_pauses(boards: BoardWorld) -> None:
    at_rest(boards)
    boards.boards[1].speaks = False
    lose(boards, 0)
    boards.run(sum(PAUSES_S) + 0.2)
    asked = boards.boards[1].asked
    assert {groups for _, groups in asked} == {15}
    pauses = [later - sooner for (sooner, _), (later, _) in pairwise(asked)]
    assert pauses == pytest.approx(PAUSES_S, abs=0.05)
    boards.boards[1].speaks = True
    boards.until_whole(2.1)


def test_lost_answers_do_not_block_the_proof(boards: BoardWorld) -> None:
    at_rest(boards)
    wire, refresh = boards.wires[0], OD_REFRESH.to_bytes(2, "little")
    wire.loses = lambda end, each: bool(
        end is wire.gateway and each["can_id"] == SDO_RESPONSE_BASE + 2 and each["data"][1:3].tobytes() == refresh
    )
    boards.boards[1].speaks = False
    lose(boards, 0)
    boards.run(8.0)
    assert boards.gateway.masters[0].nodes[2].trusted
    assert states(boards.measured[-1])[1] == BlockState.STALE
    assert not boards.lines


def test_four_nodes_of_a_bus_are_asked_at_a_time() -> None:
    contract = Contract.from_layout(small_layout(16, 32, **ADAPTIVE))
    world = BoardWorld(contract)
    world.until_whole(2.0)
    world.run(0.5)
    for board in world.boards:
        board.answers = False
    lose(world, 0)
    world.wires[0].log.clear()
    world.run(0.25)
    write = b"\x2f" + OD_REFRESH.to_bytes(2, "little")
    asked = {can_id for can_id, data in world.wires[0].log if data[:3] == write}
    assert len(asked) == 4
    for board in world.boards:
        board.answers = True
    world.until_whole(1.0)


def test_noise_is_read_again_every_ten_seconds(boards: BoardWorld) -> None:
    boards.run(0.5)
    for board in boards.boards:
        board.objects[OD_NODE_NOISE, 0] = np.float32(5e-4).tobytes()
    assert boards.run(8.0)[-1].noise_n == pytest.approx(2.5e-4)
    assert boards.run(3.0)[-1].noise_n == pytest.approx(5e-4)


def test_node_without_noise_is_not_counted(adaptive: Contract) -> None:
    world = BoardWorld(adaptive)
    for board, noise in zip(
        world.boards, (b"\0\0\0\0", b"\0\0\xc0\x7f", None, np.float32(3e-4).tobytes()), strict=True
    ):
        board.objects.pop((OD_NODE_NOISE, 0)) if noise is None else board.objects.update({(OD_NODE_NOISE, 0): noise})
    world.until_whole(1.0)
    assert world.run(0.5)[-1].noise_n == pytest.approx(3e-4)


@pytest.mark.heavy
def test_a_busy_node_does_not_hold_back_the_noise_of_the_others(
    boards: BoardWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_rest(boards)
    busy = boards.gateway.masters[0].nodes[1].foreign
    monkeypatch.setattr(ForeignClient, "free_s", property(lambda client: np.inf if client is busy else -np.inf))
    wire, read = boards.wires[0], b"\x40" + OD_NODE_NOISE.to_bytes(2, "little")
    wire.log.clear()
    boards.run(21.0)
    asked = [can_id for can_id, data in wire.log if data[:3] == read]
    assert asked.count(SDO_REQUEST_BASE + 2) == 2
    assert asked.count(SDO_REQUEST_BASE + 1) == 0
