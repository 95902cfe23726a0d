"""What a calibrator does when a zero, a touch, a gap or a defect comes for the second time."""

import numpy as np
import pytest

from calibration.calibrator import Calibrator
from canskin.calibration_messages import CalibrationStatus
from tests.calibration.test_calibrator_exactly import (
    AVERAGING,
    FOLLOWING,
    MEASURING,
    NPC,
    OFFSETS,
    PHI,
    SUMS,
    Cycles,
    offsets_of,
    pressed,
    tared,
)


def test_before_the_first_window_nothing_is_known() -> None:
    expected = CalibrationStatus(state=MEASURING)
    assert Calibrator(AVERAGING).status() == expected
    skin = Cycles()
    skin.run(1)
    assert skin.made.status() == expected


def test_a_zero_that_is_asked_for_anew_begins_anew() -> None:
    skin = Cycles()
    skin.run(7.1, OFFSETS + 100)
    skin.made.tare()
    skin.run(7.9, OFFSETS)
    assert skin.made.state is MEASURING
    skin.run(0.2, OFFSETS)
    assert skin.made.state is FOLLOWING
    assert offsets_of(skin.run(0.1)) == OFFSETS.tolist()
    assert skin.made.status().revision == 1


def test_after_a_good_zero_four_windows_below_it_are_enough_again() -> None:
    skin, hand = Cycles(), OFFSETS + pressed(10, 20, 5, 300)
    for turn in range(2):
        skin.made.tare(force=True)
        skin.run(8.1 if turn else 10.1, hand)
        assert skin.made.state is FOLLOWING
        skin.run(4, OFFSETS)
        assert skin.made.state is MEASURING
        skin.run(8.1, OFFSETS)
        assert skin.made.state is FOLLOWING


def test_windows_that_nobody_had_time_for_are_not_lost() -> None:
    skin = Cycles()
    for _ in range(101):
        skin.made.take(skin.measured(OFFSETS))
        skin.cycle += 1
    assert skin.made.state is MEASURING
    skin.made.work()
    assert skin.made.state is FOLLOWING
    skin.made.work()  # nothing is left
    assert skin.made.status().revision == 1


def test_a_late_block_begins_to_wait_anew_after_a_gap() -> None:
    skin = Cycles()
    skin.missing = [4]
    skin.run(10.1)
    skin.missing = []
    skin.run(7)  # five windows of eight
    skin.cycle += 100
    skin.run(8)  # it has settled long ago; the eighth window ends with the next cycle
    assert skin.made.status().known_sums == SUMS - 8
    skin.run(0.1)
    assert skin.made.status().known_sums == SUMS


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
    assert skin.made.status().known_sums == SUMS - 8
    skin.run(2)
    assert skin.made.status().known_sums == SUMS


@pytest.mark.parametrize(("gap", "drift"), [(9, 100.0), (30, 100.0), (70, 40.0), (70, -40.0)])
def test_offsets_have_gone_on_through_a_gap_when_its_first_window_ends(gap: int, drift: float) -> None:
    """Cycles that are missing, whole windows or nearly one; offsets are foreseen within a cycle or two of drift."""
    skin = Cycles(noise=0)
    skin.run(30, drift=drift)
    skin.cycle += gap
    skin.run(1.1, drift=drift)
    applied = skin.run(0.1, drift=drift)
    expected = OFFSETS + drift * (skin.cycle - 1) / 10
    assert np.abs(np.array(offsets_of(applied)) - expected).max() <= abs(drift) * (0.2 if gap == 9 else 0.05) + 0.6
    status = skin.made.status()
    assert status.held_blocks == 0
    assert status.drift_rms_n_per_s == pytest.approx(4 * abs(drift) * NPC, rel=0.02)


@pytest.mark.parametrize(("counts", "is_named"), [(2, False), (3, True)])
def test_noise_below_three_counts_is_no_defect(counts: int, is_named: bool) -> None:
    """Up and down by 3 counts: 3 √π = 5.3 counts, more than 1.75 times 3; by 2 counts: 3.5."""
    loud = np.where(PHI.block_of_sum == 5, counts, 1)
    skin = Cycles(noise=1)
    skin._noise = loud  # type: ignore[assignment]
    skin.run(60)
    assert [text.split(" has")[0] for text in skin.made.status().defects] == ["block 5"] * is_named
    assert sum(text.startswith("block 5") for text in skin.said) == is_named


def test_a_defect_is_said_once_and_again_when_it_has_come_back() -> None:
    stuck = np.where(np.arange(SUMS) == 33, 0, 3)
    skin = tared()
    for turn in range(2):
        skin._noise = stuck  # type: ignore[assignment]
        skin.run(15)
        words = f"sum 33 (block 4, row {PHI.row_of_sum[33]}) is stuck and left out"
        assert skin.said[1:] == [words] * (turn + 1)
        assert skin.made.status().defects == [words]
        usable = np.frombuffer(skin.run(0.1).usable, np.uint8)
        assert np.flatnonzero(usable == 0).tolist() == [33]
        skin._noise = 3
        skin.run(2)
        assert skin.made.status().defects == []
        assert skin.run(0.1).usable == b""


def test_a_skin_without_noise_feels_a_count_on_nine_taxels() -> None:
    """Their picture is a quarter of a count high, 28 times what rounding is taken for."""
    skin = Cycles(noise=0)
    skin.run(10.1)
    skin.run(1.1, OFFSETS + pressed(10, 10, 3, 1))
    assert 0 < skin.made.status().held_blocks <= PHI.blocks


def test_a_zero_that_drifts_like_a_touch_is_foreseen_and_is_none() -> None:
    """Forced: otherwise something moves on the skin."""
    skin = Cycles(noise=0)
    skin.made.tare(force=True)
    drift = pressed(10, 20, 5, 20)
    skin.run(10.1, drift=drift)  # type: ignore[arg-type]
    for _ in range(5):
        applied = skin.run(1, drift=drift)  # type: ignore[arg-type]
        assert skin.made.status().held_blocks == 0
        expected = OFFSETS + drift * (skin.cycle - 1) / 10
        assert np.abs(np.array(offsets_of(applied)) - expected).max() <= 0.05 * np.abs(drift).max() + 1


def test_a_patch_that_cools_is_followed_below_a_zero_that_nobody_forced() -> None:
    """Twenty by twenty taxels lose a count in four windows: forces below zero are no touch that has gone."""
    skin = tared()
    drift = -0.25 * pressed(10, 10, 20, 1)
    begins = OFFSETS - drift * skin.cycle / 10
    skin.run(60, begins, drift=drift)  # type: ignore[arg-type]
    for _ in range(5):
        applied = skin.run(1, begins, drift=drift)  # type: ignore[arg-type]
        assert skin.made.status().held_blocks == 0
        expected = begins + drift * (skin.cycle - 1) / 10
        assert np.abs(np.array(offsets_of(applied)) - expected).max() <= np.abs(drift).max()
