"""What goes to stepped boards in C and comes from them, with stand-ins for the boards: no compiler is needed."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from bus.link import DISCARDED
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, Frames
from nodes.steps.firmware import FirmwarePatches
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.nodes.helpers import Still


class Counted:
    """Stepped boards of one bus that keep the counts they get, and are ready after `ready_after` samples."""

    def __init__(self, bus: int, ready_after: int) -> None:
        self.bus, self.left = bus, ready_after
        self.counts: list[npt.NDArray[np.float32]] = []
        self.is_pdo = np.zeros(0x800, np.bool_)
        self.is_sending = False

    def take_counts(self, counts: npt.NDArray[np.float32]) -> bool:
        self.counts.append(counts.copy())
        self.left -= 1
        return self.left <= 0

    def choose(self, now_ns: int) -> Frames:
        return frame(self.bus, now_ns.to_bytes(8, "little"))

    def sums(self, board: int, size: int) -> npt.NDArray[np.int32]:
        return 1000 * self.bus + 100 * board + np.arange(size, dtype=np.int32)


class SteppedFirmware:
    def __init__(self) -> None:
        self.of_bus = {0: Counted(0, 3), 1: Counted(1, 5)}

    def boards(self, bus: int) -> Counted:
        return self.of_bus[bus]


@pytest.fixture
def patches() -> tuple[FirmwarePatches, dict[int, Counted], list[int]]:
    """Two boards of the first bus and one of the second, which have learned, and their blocks."""
    contract = Contract.from_layout(load_layout(Path("steps")))
    blocks = [contract.on_bus(0)[0].block, contract.on_bus(0)[2].block, contract.on_bus(1)[1].block]
    firmware = SteppedFirmware()
    made = FirmwarePatches(contract, blocks, Still(contract), firmware)  # type: ignore[arg-type]
    return made, firmware.of_bus, blocks


Made = tuple[FirmwarePatches, dict[int, Counted], list[int]]


def test_boards_sample_until_all_have_learned(patches: Made) -> None:
    _, boards, _ = patches
    assert [len(each.counts) for each in boards.values()] == [5, 5]
    assert {bus: each.counts[0].shape for bus, each in boards.items()} == {0: (2, 32), 1: (1, 32)}


def test_boards_get_the_samples_of_their_own_taxels(patches: Made) -> None:
    made, boards, blocks = patches
    made.touched_from(0)
    made.advance(100.0)
    for rows, bus in (([0, 1], 0), ([2], 1)):
        for row, mine in zip(rows, boards[bus].counts[-1], strict=True):
            assert mine.tolist() == made.counts(blocks[row]).tolist()
    assert made.counts(blocks[0]).any()


def test_boards_get_each_sample_and_decide_when_they_are_asked(patches: Made) -> None:
    made, boards, _ = patches
    for now_s in (100.0, 100.004, 100.104):  # a hundred samples late: twenty are taken
        made.advance(now_s)
    assert [len(each.counts) for each in boards.values()] == [5 + 1 + 4 + 20] * 2
    made.take_sync(0, 1, 0)  # a SYNC comes as a frame
    for bus in (0, 1):
        (one,) = made.choose(bus, 77)
        assert (one["can_id"], int.from_bytes(one["data"][:8].tobytes(), "little")) == (bus, 77)


def test_any_board_may_hold_frames(patches: Made) -> None:
    made, boards, _ = patches
    assert not made.is_sending
    for each in boards.values():
        each.is_sending = True
        assert made.is_sending
        each.is_sending = False
    assert not made.is_sending


def test_sums_of_boards_stand_at_their_blocks(patches: Made) -> None:
    made, _, blocks = patches
    found = made.sums.reshape(-1, 32)
    for block, first in zip(blocks, (0, 100, 1000), strict=True):
        assert found[block].tolist() == list(range(first, first + 32))
    assert not np.delete(found, blocks, axis=0).any()


def test_sent_tpdos_are_counted_and_all_frames_are_left_to_the_boards(patches: Made) -> None:
    made, boards, _ = patches
    boards[1].is_pdo[0x181] = True
    own = [frame(can_id, bytes(8), flags) for can_id in (0x181, 0x701) for flags in (0, ECHO, DISCARDED, ERROR)]
    assert made.take_echoes(1, np.concatenate([*own, own[1]])) == (2, 9)
    assert made.take_echoes(0, own[1]) == (0, 1)
