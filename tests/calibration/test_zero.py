"""The zero follows what cannot be a force, and nothing that may be one."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter

from calibration.calibrator import Calibrator
from calibration.doubt import Doubt
from canskin.calibration_messages import ZeroSupport
from skin.measured_sums import decode_measurement
from tests.calibration.helpers import (
    COLUMNS,
    COUNTS,
    LAYOUT,
    NOISE_N,
    PHI,
    SMALL,
    SMALL_PHI,
    SMALL_SUMS,
    Cycles,
    FedZero,
    Skin,
    error_n,
    offsets_n,
    offsets_of,
    pressed,
    pressed_counts,
    small_patch,
    still,
    tared,
)

ZERO = np.zeros(LAYOUT.taxels.count)
OFFSETS = offsets_n()
#: Noise of one sum.
SUM_NOISE_N = NOISE_N * LAYOUT.measurement.block_size**0.5
Floats = npt.NDArray[np.float64]
RANGE_N = SMALL.taxels.force_max_n
#: Squares of 4 x 4 taxels in the corners, and taxels far from them.
REFERENCES = sum(small_patch(row, column, 4, 1.0) for row in (0, 28) for column in (0, 28)) > 0
MIDDLE = small_patch(8, 8, 16, 1.0) > 0
PATCH, HAND = small_patch(4, 4, 10, 3e-3), small_patch(20, 20, 8, 4e-3)


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


def begun(support: ZeroSupport = ZeroSupport.MEASURED) -> FedZero:
    made = FedZero(support)
    made.run(20, 0.0)
    return made


def near(found: Floats, expected: Floats | float, within_n: float = 0.15e-3) -> bool:
    """Tell whether fields agree within the error of a field."""
    return bool(np.abs(found - expected).max() < within_n)


@pytest.mark.parametrize("support", [ZeroSupport.MEASURED, ZeroSupport.STORED])
def test_a_step_down_is_corrected_within_a_second_and_there_alone(support: ZeroSupport) -> None:
    made = begun(support)
    made.run(4, -PATCH)
    assert near(made.moved_n, -PATCH)
    assert made.zero.force_n.max() < 0.05e-3
    made.run(100, -PATCH)
    assert near(made.moved_n, -PATCH)


def test_a_step_up_is_never_followed() -> None:
    made = begun()
    made.run(400, PATCH)
    assert near(made.moved_n, 0.0)
    assert near(made.zero.force_n, PATCH)
    assert (made.zero.touched >= (PATCH > 0)).all()


@pytest.mark.heavy
def test_of_a_slow_growth_85_percent_are_kept() -> None:
    """Twelve by twelve taxels, 1 mN in two minutes."""
    made = begun()
    made.run(480, lambda window: small_patch(10, 10, 12, 1e-3 * (window - 20) / 480))
    assert made.zero.force_n.sum() > 0.85 * 144e-3


def test_a_fall_under_a_touch_elsewhere_is_corrected() -> None:
    made = begun()
    made.run(40, HAND)
    made.run(8, HAND - PATCH)
    assert near(made.moved_n, -PATCH, 0.3e-3)
    assert near(made.zero.force_n, HAND)


def test_what_is_below_zero_for_two_windows_under_a_touch_moves_nothing() -> None:
    made = begun()
    made.run(40, HAND)
    for _ in range(5):
        made.run(2, HAND - PATCH)
        made.run(2, HAND)
    assert near(made.moved_n, 0.0)


def test_what_fell_under_a_touch_comes_back_at_once() -> None:
    made = begun()
    made.run(40, HAND)
    made.run(8, HAND - PATCH)
    made.run(4, HAND)
    assert near(made.moved_n, 0.0)
    assert near(made.zero.force_n, HAND)


@pytest.mark.heavy
@pytest.mark.parametrize("tau_windows", [20, 120, 480])
def test_hysteresis_that_recovers_leaves_no_force(tau_windows: int) -> None:
    """A press leaves 0.3 mN below zero, 1.5 % of the range, which go with 5 to 120 s."""
    made = begun()
    made.run(40, 2 * PATCH)
    made.run(6 * tau_windows, lambda window: -0.1 * PATCH * np.exp((60 - window) / tau_windows))
    assert near(made.zero.force_n, 0.0)
    assert near(made.moved_n, 0.0)


@pytest.mark.heavy
def test_a_slow_rise_of_all_taxels_is_followed_and_a_fast_one_is_a_press() -> None:
    slow, fast = begun(), begun()
    slow.run(480, lambda window: np.full(1024, 2e-3 * (window - 20) / 480))
    assert near(slow.moved_n, 2e-3)
    assert near(slow.zero.force_n, 0.0)
    fast.run(400, 2e-3)
    assert near(fast.zero.force_n, 2e-3)


def with_references() -> FedZero:
    made = FedZero(references=REFERENCES)
    made.run(20, 0.0)
    return made


def test_references_tell_a_fast_rise_of_all_taxels_from_a_press_of_all_others() -> None:
    warms, pressed_all = with_references(), with_references()
    warms.run(2, 3e-3)
    assert near(warms.moved_n, 3e-3)
    assert near(warms.zero.force_n, 0.0)
    pressed_all.run(8, np.where(REFERENCES, 0.0, 3e-3))
    assert near(pressed_all.moved_n, 0.0)
    assert near(pressed_all.zero.force_n[MIDDLE], 3e-3)


def test_references_tell_a_rise_under_a_press_of_all_others() -> None:
    made = with_references()
    made.run(8, np.where(REFERENCES, 0.0, 3e-3))
    made.run(8, np.where(REFERENCES, 0.0, 3e-3) + 1e-3)
    assert near(made.moved_n[MIDDLE], 1e-3)
    assert near(made.zero.force_n[MIDDLE], 3e-3)


def test_references_that_disagree_tell_nothing() -> None:
    """Half of them are pressed with all of the skin: the press keeps its force."""
    made = with_references()
    made.run(8, np.where(REFERENCES & (np.arange(1024) < 512), 0.0, 3e-3))
    assert near(made.moved_n, 0.0)
    assert near(made.zero.force_n[MIDDLE], 3e-3)


@pytest.mark.heavy
def test_a_touch_of_ten_minutes_keeps_95_percent_and_leaves_nothing() -> None:
    made = begun()
    made.run(2400, HAND)
    assert made.zero.force_n.sum() > 0.95 * HAND.sum()
    made.run(4, 0.0)
    assert near(made.zero.force_n, 0.0)


def test_a_stored_zero_follows_a_warmer_skin_under_a_hand() -> None:
    """All taxels read 1 mN more than when the zero was stored; of a measured zero that is a press."""
    made = FedZero(ZeroSupport.STORED)
    made.run(8, 1e-3 + HAND)
    assert near(made.moved_n, 1e-3)
    assert near(made.zero.force_n, HAND)


@pytest.mark.heavy
def test_slopes_of_patches_do_not_run_on() -> None:
    """A patch cools by 3 mN in twenty seconds, stops, and is then touched elsewhere."""
    made = begun()
    made.run(80, lambda window: -PATCH * (window - 20) / 80)
    assert near(made.moved_n, -PATCH)
    made.run(40, HAND - PATCH)
    assert near(made.moved_n, -PATCH)
    assert near(made.zero.force_n, HAND)


def test_what_stands_in_a_region_is_settled_there_alone() -> None:
    made = begun()
    made.run(10, PATCH + HAND)
    mean_n = SMALL_PHI.forward(PATCH + HAND)
    made.zero.settle(mean_n, made.known, PATCH > 0)
    made.run(10, PATCH + HAND)
    assert near(made.zero.force_n, HAND, 0.3e-3)
    made.run(4, HAND)
    assert near(made.zero.force_n, HAND, 0.3e-3)  # what left the region was taken off the zero again
    assert near(made.moved_n, 0.0, 0.3e-3)


SQUARE = st.tuples(st.integers(0, 26), st.integers(0, 26), st.integers(3, 14))
STEP = st.tuples(st.just("step"), SQUARE, st.floats(-5, 5))
TOUCH = st.tuples(st.just("hand"), SQUARE, st.floats(0.2, 8))


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(events=st.lists(st.tuples(STEP | TOUCH, st.integers(1, 40), st.integers(0, 20)), min_size=1, max_size=4))
def test_no_zero_goes_where_its_taxel_has_not_been(
    events: list[tuple[tuple[str, tuple[int, int, int], float], int, int]],
) -> None:
    """Patches step by up to 5 mN, up or down, and hands come and go.

    Each taxel's zero stays between the smallest and the largest drift that there has been around it, within 0.3 mN and
    the error of a field, a tenth of the largest step. What then stands on the untouched skin is doubtful.
    """
    made, doubt = begun(), Doubt(1024, RANGE_N, 0.25)
    drift_n, lowest_n, highest_n, largest_n = *np.zeros((3, 1024)), 0.0

    def run(windows: int, touch_n: Floats | float) -> None:
        for _ in range(windows):
            made.run(1, drift_n + touch_n)
            doubt.move(made.zero.moved_n)
            doubt.take(made.zero.force_n, made.windows)

    for (kind, square, force_mn), windows, pause in events:
        changed_n = small_patch(*square, 1e-3 * force_mn)
        if kind == "step":
            changed_n = np.clip(drift_n + changed_n, -7e-3, 7e-3) - drift_n
            drift_n = drift_n + changed_n
            largest_n = max(largest_n, np.abs(changed_n).max())
            lowest_n, highest_n = np.minimum(lowest_n, drift_n), np.maximum(highest_n, drift_n)
        run(windows, changed_n if kind == "hand" else 0.0)
        moved_n, allowed_n = made.moved_n.reshape(32, 32), 0.3e-3 + 0.1 * largest_n
        assert (moved_n > minimum_filter(lowest_n.reshape(32, 32), 3) - allowed_n).all()
        assert (moved_n < maximum_filter(highest_n.reshape(32, 32), 3) + allowed_n).all()
        run(pause, 0.0)
    run(40, 0.0)
    assert made.zero.force_n[~doubt.taxels].max() < 0.4e-3


@pytest.mark.parametrize("sign", [1, -1])
def test_a_thin_ring_on_most_boards_is_a_touch_and_its_end_no_drift(sign: int) -> None:
    """Neighbouring taxels share little of it, so it looks like noise but for its sign."""
    row, column = np.mgrid[0:32, 0:32] - 15.5
    ring = np.where(np.abs(np.hypot(row, column) - 9) < 0.6, 7e-3, 0.0).ravel()
    made = begun()
    made.run(12, sign * ring)
    if sign > 0:
        assert made.zero.force_n.sum() > 0.8 * ring.sum()
        assert np.abs(made.zero.follower.level_n).max() < 1e-3
        made.run(8, 0.0)
        assert not made.zero.touched.any()
    assert made.zero.force_n.max() < 1e-3
