"""The gateway on CAN FD buses of adaptive boards: a frame carries a whole block."""

import numpy as np
import pytest

from canskin.messages import BlockState
from dbc.adaptive import FIRST_COB_ID
from dbc.frame import FD
from tests.bus.harness import frame
from tests.gateway.boards import BoardWorld, lose, small_adaptive, states, sums_of
from tests.layouts import buses


@pytest.fixture
def boards() -> BoardWorld:
    """Return a skin on CAN FD all of whose blocks are valid, the second touched."""
    built = BoardWorld(small_adaptive(bus=buses(2, 2, fd=True, data_bitrate=5_000_000)))
    built.touch(1)
    built.until_whole(1.0)
    return built


def holds_what_boards_hold(world: BoardWorld) -> bool:
    world.run(0.3)
    return all(np.array_equal(sums_of(world.measured[-1], block), world.known_counts(block)) for block in range(4))


def test_measurement_holds_the_sums_of_the_boards(boards: BoardWorld) -> None:
    assert holds_what_boards_hold(boards)
    assert sums_of(boards.measured[-1], 1).any()
    for seed in range(20):
        boards.touch(2, seed)
        boards.run(0.02)
    assert holds_what_boards_hold(boards)
    counts = boards.status().frames
    assert (counts.unrefined, counts.malformed) == (0, 0)
    assert counts.accepted == sum(board.sent for board in boards.boards)


def test_a_loss_makes_blocks_stale_until_their_next_frame_which_is_asked_for(boards: BoardWorld) -> None:
    boards.run(1.0)
    before = [len(board.asked) for board in boards.boards]
    lose(boards, 0)
    assert {BlockState.STALE} == set(states(boards.step()[-1])[:2])
    boards.until_whole(1.0)
    asked = [len(board.asked) - count for board, count in zip(boards.boards, before, strict=True)]
    assert asked[0] > 0 < asked[1]
    assert asked[2:] == [0, 0]
    assert holds_what_boards_hold(boards)


@pytest.mark.parametrize(
    ("length", "flags", "field"), [(8, FD, "malformed"), (32, 0, "foreign"), (64, FD, "malformed")]
)
def test_frames_of_another_shape_are_counted_and_not_used(
    boards: BoardWorld, length: int, flags: int, field: str
) -> None:
    boards.run(0.1)
    held, before = sums_of(boards.measured[-1], 0).copy(), getattr(boards.status().frames, field)
    boards.wires[0].nodes.send(frame(FIRST_COB_ID, b"\x90" * length, flags=flags))
    boards.step()
    assert getattr(boards.status().frames, field) == before + 1
    assert np.array_equal(sums_of(boards.measured[-1], 0), held)
