"""The zero follows what cannot be a force, and nothing that may be one."""

import numpy as np

from calibration.calibrator import Calibrator
from canskin.calibration_messages import CalibrationState
from skin.measured_sums import decode_measurement
from tests.calibration.skins import (
    COLUMNS,
    COUNTS,
    LAYOUT,
    NOISE_N,
    PHI,
    SMALL_PHI,
    SMALL_SUMS,
    Cycles,
    Skin,
    error_n,
    offsets_n,
    offsets_of,
    pressed,
    pressed_counts,
    still,
    tared,
)

MS = 1_000_000
MEASURING, TOUCHED = CalibrationState.MEASURING, CalibrationState.TOUCHED
FOLLOWING, LOADED, OFF = CalibrationState.FOLLOWING, CalibrationState.LOADED, CalibrationState.OFF

ZERO = np.zeros(LAYOUT.taxels.count)
OFFSETS = offsets_n()
#: Noise of one sum.
SUM_NOISE_N = NOISE_N * LAYOUT.measurement.block_size**0.5


def test_under_a_touch_blocks_are_held_and_counted() -> None:
    skin = tared()
    skin.run(1, COUNTS + pressed_counts(0, 0, 20, 300))
    held = skin.run(1, COUNTS + pressed_counts(0, 0, 20, 300))
    assert skin.made.status().held_blocks == SMALL_PHI.blocks
    assert np.abs(np.array(offsets_of(held)) - COUNTS).max() <= 1
    skin.run(2, COUNTS)
    assert skin.made.status().held_blocks == 0


def test_a_late_block_gets_its_zero_after_eight_windows_of_its_own() -> None:
    skin = Cycles()
    skin.missing = [4]
    skin.run(10.1)
    assert skin.made.status().known_sums == SMALL_SUMS - 8
    skin.missing = []
    last = skin.run(9.9)  # half a second to settle, and eight windows, of which the last ends with the next cycle
    assert skin.made.status().known_sums == SMALL_SUMS - 8
    usable = np.frombuffer(last.usable, np.uint8)
    assert np.flatnonzero(usable == 0).tolist() == np.flatnonzero(SMALL_PHI.block_of_sum == 4).tolist()
    skin.run(0.1)
    assert skin.made.status().known_sums == SMALL_SUMS
    last = skin.run(0.1)
    assert last.usable == b""
    assert offsets_of(last) == COUNTS.tolist()
    assert skin.made.status().revision == 1


def test_a_late_block_begins_to_wait_anew_after_a_gap() -> None:
    skin = Cycles()
    skin.missing = [4]
    skin.run(10.1)
    skin.missing = []
    skin.run(7)  # five windows of eight
    skin.cycle += 100
    skin.run(8)  # it has settled long ago; the eighth window ends with the next cycle
    assert skin.made.status().known_sums == SMALL_SUMS - 8
    skin.run(0.1)
    assert skin.made.status().known_sums == SMALL_SUMS


def test_a_late_block_begins_to_wait_anew_after_it_was_missing() -> None:
    skin = Cycles()
    skin.missing = [4]
    skin.run(10.1)
    skin.missing = []
    skin.run(7)
    skin.missing = [4]
    skin.run(1)
    skin.missing = []
    skin.run(9)
    assert skin.made.status().known_sums == SMALL_SUMS - 8
    skin.run(2)
    assert skin.made.status().known_sums == SMALL_SUMS


def test_a_block_that_comes_later_gets_its_zero_later() -> None:
    skin = Skin(Calibrator(LAYOUT))
    valid = np.arange(LAYOUT.blocks) > 0
    skin.run(4.0, still(OFFSETS), valid=valid)
    assert skin.calibrator.status().known_sums == PHI.shape[0] - 8
    last = skin.run(4.0, still(OFFSETS))
    assert skin.calibrator.status().known_sums == PHI.shape[0]
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N


def test_a_block_that_comes_under_a_touch_is_left_out_until_the_touch_ends() -> None:
    skin, late = Skin(Calibrator(LAYOUT)), 5
    row, column = divmod(int(PHI.taxels_of_blocks[late][0]), COLUMNS)
    touch = pressed(max(row - 4, 0), max(column - 4, 0), 9, 0.01)
    skin.run(4.0, still(OFFSETS), valid=np.arange(LAYOUT.blocks) != late)
    for _ in range(8):
        sums = decode_measurement(skin.run(0.5, still(OFFSETS + touch)), PHI)
        assert not sums.valid[late]
        assert not sums.counts[PHI.block_of_sum == late].any()
        assert sums.valid.sum() == LAYOUT.blocks - 1
    last = skin.run(4.0, still(OFFSETS))
    assert decode_measurement(last, PHI).valid.all()
    assert error_n(last, ZERO) < 1.2 * SUM_NOISE_N
