"""The gateway on CAN FD buses of stepped boards: a frame carries a whole block."""

import numpy as np
import pytest

from canskin.messages import BlockState
from dbc.frame import FD
from tests.bus.harness import frame
from tests.gateway.boards import BoardWorld, lose, small_stepped, sums_of
from tests.layouts import buses


@pytest.fixture
def boards() -> BoardWorld:
    """Return a skin on CAN FD all of whose blocks are valid, the second touched."""
    built = BoardWorld(small_stepped(bus=buses(2, 2, fd=True, data_bitrate=5_000_000)))
    built.touch(1)
    built.until_whole(1.0)
    return built


def test_measurement_holds_the_sums_of_the_boards(boards: BoardWorld) -> None:
    assert boards.holds_what_boards_hold()
    assert sums_of(boards.measured[-1], 1).any()
    for seed in range(20):
        boards.touch(2, seed)
        boards.run(0.02)
    assert boards.holds_what_boards_hold()
    counts = boards.status().frames
    assert (counts.after_gap, counts.malformed) == (0, 0)
    assert counts.accepted == sum(board.sent for board in boards.boards)


def test_a_loss_makes_a_block_stale_until_its_groups_have_come_again(boards: BoardWorld) -> None:
    boards.run(0.3)
    lose(boards, 0)
    boards.touch(0, 18)
    assert boards.run(0.01)[-1].states[0] == BlockState.STALE
    assert boards.until_whole(1.0) <= 0.05
    assert [len(board.asked) for board in boards.boards] == [1, 0, 0, 0]
    assert boards.holds_what_boards_hold()


@pytest.mark.parametrize(
    ("length", "flags", "field"), [(8, FD, "malformed"), (32, 0, "foreign"), (64, FD, "malformed")]
)
def test_frames_of_another_shape_are_counted_and_not_used(
    boards: BoardWorld, length: int, flags: int, field: str
) -> None:
    boards.run(0.1)
    held, before = sums_of(boards.measured[-1], 0).copy(), getattr(boards.status().frames, field)
    boards.wires[0].nodes.send(frame(boards.contract.nodes[0].tpdos[0].cob_id, b"\x90" * length, flags=flags))
    boards.step()
    assert getattr(boards.status().frames, field) == before + 1
    assert np.array_equal(sums_of(boards.measured[-1], 0), held)
