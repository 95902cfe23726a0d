"""Calibration and test patterns of the blocks of a skin: each write goes to the taxels of its block alone."""

import numpy as np
import numpy.typing as npt
import pytest

from canskin.messages import Truth
from nodes.electronics import Calibration
from nodes.hardware import Hardware
from skin.layout import load_layout

LAYOUT = load_layout()
PHI = LAYOUT.phi()
BLOCK, TAXELS = 5, LAYOUT.taxels.count
#: Its 32 taxels in the order of the chain.
CHAIN = PHI.order[5 * 32 : 6 * 32]
OTHERS = np.setdiff1d(np.arange(TAXELS), CHAIN)
GAIN, OFFSET, PATTERN = 0x2010, 0x2011, 0x2021


class Plain(Hardware):
    """Boards whose taxels read what the test says."""

    def __init__(self, calibration: Calibration) -> None:
        super().__init__(PHI, calibration)
        self.read = np.zeros(TAXELS, np.int32)

    @property
    def sums(self) -> npt.NDArray[np.int32]:
        return np.zeros(PHI.shape[0], np.int32)

    def counts(self, block: int) -> npt.NDArray[np.int32]:
        return self.read[self._chain(block)]

    def take_truth(self) -> Truth | None:
        return None

    def prepare(self) -> None:
        """Nothing is asked for."""


@pytest.fixture
def calibration() -> Calibration:
    return Calibration(LAYOUT.taxels)


@pytest.fixture
def boards(calibration: Calibration) -> Plain:
    return Plain(calibration)


@pytest.mark.parametrize("subindex", [1, 2, 31, 32])
def test_a_gain_and_an_offset_go_to_one_taxel_of_the_chain(
    boards: Plain, calibration: Calibration, subindex: int
) -> None:
    boards.adjust(BLOCK, GAIN, subindex, 1.5)
    boards.adjust(BLOCK, OFFSET, subindex, -7)
    assert np.flatnonzero(calibration.gain != 1).tolist() == [CHAIN[subindex - 1]]
    assert np.flatnonzero(calibration.offset != 0).tolist() == [CHAIN[subindex - 1]]
    assert (calibration.gain[CHAIN[subindex - 1]], calibration.offset[CHAIN[subindex - 1]]) == (1.5, -7)
    assert (calibration.pattern == -1).all()


@pytest.mark.parametrize("subindex", [0, 33, 255])
def test_places_that_no_taxel_has_change_nothing(boards: Plain, calibration: Calibration, subindex: int) -> None:
    boards.adjust(BLOCK, GAIN, subindex, 3.0)
    boards.adjust(BLOCK, OFFSET, subindex, 3.0)
    boards.adjust(BLOCK, 0x2012, 1, 3.0)  # another object
    assert (calibration.gain == 1).all()
    assert (calibration.offset == 0).all()
    assert boards.pattern(BLOCK) == 0


@pytest.mark.parametrize(("pattern", "shown"), [(1, [0] * 32), (2, [*range(32)]), (3, [1023] * 32)])
def test_a_pattern_is_shown_by_its_block_until_it_is_switched_off(
    boards: Plain, calibration: Calibration, pattern: int, shown: list[int]
) -> None:
    boards.adjust(BLOCK, PATTERN, 0, pattern)
    assert boards.pattern(BLOCK) == pattern
    assert calibration.pattern[CHAIN].tolist() == shown
    assert (calibration.pattern[OTHERS] == -1).all()
    assert [boards.pattern(block) for block in (4, 6)] == [0, 0]
    boards.adjust(BLOCK, PATTERN, 0, 0)
    assert boards.pattern(BLOCK) == 0
    assert (calibration.pattern == -1).all()


def test_a_reset_sets_one_block_to_the_defaults(boards: Plain, calibration: Calibration) -> None:
    calibration.gain[:], calibration.offset[:] = 2.0, 9.0
    for block in (BLOCK, BLOCK + 1):
        boards.adjust(block, PATTERN, 0, 3)
    boards.reset(BLOCK)
    assert (calibration.gain[CHAIN] == 1).all()
    assert (calibration.offset[CHAIN] == 0).all()
    assert (calibration.pattern[CHAIN] == -1).all()
    assert (calibration.gain[OTHERS] == 2).all()
    assert (calibration.offset[OTHERS] == 9).all()
    assert [boards.pattern(block) for block in (BLOCK, BLOCK + 1)] == [0, 3]


def test_taxels_at_the_top_of_their_range_are_saturated(boards: Plain) -> None:
    boards.read[CHAIN[:3]] = 1023
    boards.read[CHAIN[3]] = 1022
    boards.read[OTHERS] = 1023
    assert boards.saturated(BLOCK) == 3
