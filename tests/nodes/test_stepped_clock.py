"""The clock of stepped boards: a sample each millisecond, a truth each 10 ms, and what a late process leaves out."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from dbc.contract import Contract
from dbc.frame import Frames
from nodes.steps.patch_boards import PatchBoards
from skin.layout import load_layout
from skin.sources import Frame
from tests.nodes.helpers import Still

MS = 1_000_000


class Ticks(PatchBoards):
    """Boards of two blocks that count their samples and decisions."""

    def __init__(self, contract: Contract) -> None:
        super().__init__(contract, [3, 7], Source(contract))
        self.cells = contract.phi.taxels_of_blocks[[3, 7]]
        self.samples = 0
        self.decisions: list[int] = []

    def _take(self, sample_n: npt.NDArray[np.float32]) -> None:
        assert sample_n.shape == (2, 32)
        self.samples += 1

    def _decide(self, now_ns: int) -> None:
        self.decisions.append(now_ns)

    def count(self, bus: int, arrived: Frames, is_pdo: npt.NDArray[np.bool_]) -> tuple[int, int, int]:
        return 0, 0, len(arrived)


class Source(Still):
    """The same touch for ever, whose label is its step."""

    def frame(self, step: int) -> Frame:
        return Frame(self.force_n, str(step))


@pytest.fixture
def boards() -> Ticks:
    return Ticks(Contract.from_layout(load_layout(Path("steps"))))


def test_the_first_turn_takes_a_sample_and_the_next_is_a_millisecond_later(boards: Ticks) -> None:
    assert boards.due_s == 0
    boards.advance(100.0)
    assert boards.samples == 1
    assert boards.due_s == pytest.approx(100.001)
    boards.advance(100.0009)
    assert boards.samples == 1
    boards.advance(100.001)
    boards.advance(100.0045)
    assert boards.samples == 1 + 1 + 3
    assert boards.due_s == pytest.approx(100.005)
    first = 100_000 * MS
    assert boards.decisions == [first, first + MS, first + 4_500_000]


@pytest.mark.parametrize(("late", "taken"), [(20, 20), (21, 20), (100, 20)])
def test_a_late_process_takes_twenty_samples_and_leaves_the_others_out(boards: Ticks, late: int, taken: int) -> None:
    boards.advance(100.0)
    boards.advance(100.0 + late / 1000)
    assert boards.samples == 1 + taken
    assert boards.decisions[1] == (100_000 + late) * MS
    assert boards.due_s == pytest.approx(100.001 + late / 1000)


def test_a_truth_comes_with_the_first_sample_of_each_step_of_the_touch(boards: Ticks) -> None:
    boards.advance(100.0)
    assert boards.take_truth() is None
    begin_ns = 100_005 * MS + 400_000
    boards.at_sync(0, 1, begin_ns)
    boards.at_sync(0, 1, 7)  # it has begun
    for tick in range(1, 27):
        boards.advance(100.0 + tick / 1000)
    truths = [boards.take_truth() for _ in range(3)]
    assert [None if truth is None else (truth.step, truth.sampled_mono_ns, truth.label) for truth in truths] == [
        (0, begin_ns, "0"),
        (1, begin_ns + 10 * MS, "1"),
        (2, begin_ns + 20 * MS, "2"),
    ]
    assert boards.take_truth() is None
    last = truths[2]
    assert last is not None
    assert last.sync_counter == 0
    sensor, true = (np.frombuffer(each, "<f4") for each in (last.sensor, last.true))
    cells = boards.cells
    assert not np.delete(sensor, cells.ravel()).any()
    # Boards of a source with noise of its own add none: half a count of 20 mN / 1023.
    assert np.abs(sensor - true)[cells].max() <= 0.51 * 0.02 / 1023
    assert boards.counts(7).tolist() == np.rint(sensor[cells[1]] / np.float32(0.02 / 1023)).tolist()


def test_of_the_truths_that_nobody_takes_the_newest_twenty_are_kept(boards: Ticks) -> None:
    boards.advance(100.0)
    boards.at_sync(0, 1, 100_001 * MS)
    for tick in range(1, 302):
        boards.advance(100.0 + tick / 1000)
    steps = []
    while (truth := boards.take_truth()) is not None:
        steps.append(truth.step)
    assert steps == list(range(11, 31))
