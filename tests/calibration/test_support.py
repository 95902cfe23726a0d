"""What the zero of each block rests on, from window to window."""

import numpy as np
import pytest

from calibration.support import CALM_WINDOWS, Support
from canskin.calibration_messages import ZeroSupport
from tests.calibration.skins import SMALL_PHI, SMALL_SUMS, FedZero, small_patch

ALL = np.ones(SMALL_SUMS, np.bool_)
BLOCKS = SMALL_PHI.blocks
PATCH = small_patch(4, 4, 10, 3e-3)


class Supported:
    """A zero, its support, and windows of nanoseconds."""

    def __init__(self, begins: ZeroSupport) -> None:
        self.fed, self.support = FedZero(), Support(SMALL_PHI)
        self.support.begin(ALL, begins, 1)

    def run(self, windows: int, felt_n: np.ndarray | float = 0.0) -> set[int]:
        """Let so many windows pass; return the supports of the blocks."""
        for _ in range(windows):
            self.fed.run(1, felt_n)
            self.support.take(self.fed.zero, self.fed.window)
        return set(self.support.of_blocks.tolist())


def test_before_a_zero_there_is_no_support() -> None:
    support = Support(SMALL_PHI)
    assert support.of_blocks.tolist() == [ZeroSupport.NONE] * BLOCKS
    assert not support.since_ns.any()


@pytest.mark.parametrize("begins", [ZeroSupport.STORED, ZeroSupport.MEASURED, ZeroSupport.TOLD])
def test_blocks_with_all_their_sums_begin_as_their_zero_does(begins: ZeroSupport) -> None:
    """A stored zero was measured at a time that nobody knows."""
    support, known = Support(SMALL_PHI), ALL.copy()
    known[np.flatnonzero(SMALL_PHI.block_of_sum == 4)[0]] = False
    support.begin(known, begins, 77)
    of_blocks, since_ns = [begins] * BLOCKS, [0 if begins is ZeroSupport.STORED else 77] * BLOCKS
    of_blocks[4], since_ns[4] = ZeroSupport.NONE, 0
    assert support.of_blocks.tolist() == of_blocks
    assert support.since_ns.tolist() == since_ns


def test_a_stored_zero_is_measured_after_calm_windows() -> None:
    made = Supported(ZeroSupport.STORED)
    assert made.run(CALM_WINDOWS - 1) == {ZeroSupport.STORED}
    assert not made.support.since_ns.any()
    assert made.run(1) == {ZeroSupport.MEASURED}
    assert set(made.support.since_ns) == {CALM_WINDOWS}


def test_under_a_touch_nothing_is_measured() -> None:
    made = Supported(ZeroSupport.STORED)
    assert made.run(2 * CALM_WINDOWS, PATCH) == {ZeroSupport.STORED}
    made.run(1)  # the touch ends
    assert made.run(CALM_WINDOWS) == {ZeroSupport.MEASURED}
    held = made.run(4, PATCH), made.fed.windows
    assert held[0] == {ZeroSupport.MEASURED}
    assert set(made.support.since_ns[made.fed.zero.held]) == {held[1] - 4}


def test_a_fall_is_corrected_in_its_blocks_and_then_measured() -> None:
    made = Supported(ZeroSupport.MEASURED)
    made.run(CALM_WINDOWS)
    assert ZeroSupport.CORRECTED in made.run(3, -PATCH)
    fallen = np.unique(SMALL_PHI.block_of_taxel[PATCH > 0])
    assert (made.support.of_blocks[fallen] == ZeroSupport.CORRECTED).all()
    assert made.run(2 * CALM_WINDOWS, -PATCH) == {ZeroSupport.MEASURED}


def test_what_a_person_told_stays_until_it_falls() -> None:
    made = Supported(ZeroSupport.MEASURED)
    made.run(CALM_WINDOWS)
    told = np.unique(SMALL_PHI.block_of_taxel[PATCH > 0])
    made.support.tell(PATCH > 0, 5)
    made.run(2 * CALM_WINDOWS)
    assert np.flatnonzero(made.support.of_blocks == ZeroSupport.TOLD).tolist() == told.tolist()
    assert set(made.support.since_ns[told]) == {5}
    made.run(3, -PATCH)
    assert set(made.support.of_blocks[told]) == {ZeroSupport.CORRECTED}
