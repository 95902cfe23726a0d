"""The zero follows what cannot be a force, and nothing that may be one."""

from collections.abc import Callable

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


def begun() -> FedZero:
    made = FedZero()
    made.run(20, 0.0)
    return made


def near(found: Floats, expected: Floats | float, within_n: float = 0.15e-3) -> bool:
    """Tell whether fields agree within the error of a field."""
    return bool(np.abs(found - expected).max() < within_n)


OTHERS = np.where(REFERENCES, 0.0, 3e-3)
STORED = ZeroSupport.STORED
Felt = Floats | float | Callable[[int], Floats]


def slowly(end_n: Floats | float, windows: int) -> Callable[[int], Floats]:
    """Grow evenly from window 20 on, where stories begin."""
    return lambda window: np.broadcast_to(end_n, 1024) * (window - 20) / windows


#: What taxels feel, drift included, for so many windows; where the zero and the force of the taxels are then.
STORIES: dict[str, tuple[list[tuple[int, Felt]], Floats | float, Floats | float]] = {
    "a step down is corrected within a second and there alone": ([(4, -PATCH)], -PATCH, 0.0),
    "a correction stays": ([(104, -PATCH)], -PATCH, 0.0),
    "a step up is never followed": ([(400, PATCH)], 0.0, PATCH),
    "a fall under a touch elsewhere is corrected": ([(40, HAND), (8, HAND - PATCH)], -PATCH, HAND),
    "two windows below zero under a touch move nothing": (
        [(40, HAND), *[(2, HAND - PATCH), (2, HAND)] * 5],
        0.0,
        HAND,
    ),
    "what fell under a touch comes back at once": ([(40, HAND), (8, HAND - PATCH), (4, HAND)], 0.0, HAND),
    "a press of twice what fell is a touch": (
        [(40, HAND), (8, HAND - PATCH), (4, HAND + 2 * PATCH)],
        -PATCH,
        HAND + 3 * PATCH,
    ),
    "a slow rise of all taxels is followed": ([(480, slowly(2e-3, 480))], 2e-3, 0.0),
    "a fast rise of all taxels is a press": ([(400, 2e-3)], 0.0, 2e-3),
    "the slope of a patch does not run on": (
        [(80, slowly(-PATCH, 80)), (40, HAND - PATCH)],
        -PATCH,
        HAND,
    ),
    "a stored zero: a step down": ([(4, -PATCH)], -PATCH, 0.0),
    "a stored zero: a warmer skin under a hand": ([(8, 1e-3 + HAND)], 1e-3, HAND),
    "references: all taxels warm at once": ([(2, 3e-3)], 3e-3, 0.0),
    "references: all others are pressed": ([(8, OTHERS)], 0.0, OTHERS),
    "references: a rise under a press of all others": ([(8, OTHERS), (8, OTHERS + 1e-3)], 1e-3, OTHERS),
    "references that disagree tell nothing": (
        [(8, np.where(np.arange(1024) < 512, OTHERS, 3e-3))],
        0.0,
        3e-3,
    ),
}


@pytest.mark.heavy
@pytest.mark.parametrize("story", STORIES)
def test_the_zero_follows_what_is_no_force(story: str) -> None:
    phases, moved_n, force_n = STORIES[story]
    made = FedZero(
        STORED if "stored" in story else ZeroSupport.MEASURED, REFERENCES if "references" in story else False
    )
    if "warmer" not in story:
        made.run(20, 0.0)
    for windows, felt in phases:
        made.run(windows, felt)
    seen = MIDDLE if "references" in story else np.ones(1024, np.bool_)
    assert near(made.moved_n[seen], np.broadcast_to(moved_n, 1024)[seen], 0.3e-3)
    assert near(made.zero.force_n[seen], np.broadcast_to(force_n, 1024)[seen])


@pytest.mark.heavy
def test_of_a_slow_growth_85_percent_are_kept() -> None:
    """Twelve by twelve taxels, 1 mN in two minutes."""
    made = begun()
    made.run(480, lambda window: small_patch(10, 10, 12, 1e-3 * (window - 20) / 480))
    assert made.zero.force_n.sum() > 0.85 * 144e-3


@pytest.mark.heavy
def test_hysteresis_that_recovers_leaves_no_force() -> None:
    """A press leaves 0.3 mN below zero, 1.5 % of the range, which go with 30 s."""
    made, tau_windows = begun(), 120
    made.run(40, 2 * PATCH)
    made.run(6 * tau_windows, lambda window: -0.1 * PATCH * np.exp((60 - window) / tau_windows))
    assert near(made.zero.force_n, 0.0)
    assert near(made.moved_n, 0.0)


@pytest.mark.heavy
def test_a_touch_of_ten_minutes_keeps_its_force_while_taxels_drift_each_its_own_way() -> None:
    """By 10 µN/s rms: 6 mN in all, more than the touch itself."""
    rate_n = np.random.default_rng(0).normal(0, 2.5e-6, 1024)
    made = begun()
    made.run(2400, lambda window: HAND + rate_n * (window - 20))
    assert made.zero.force_n[HAND > 0].sum() > 0.95 * HAND.sum()
    assert made.zero.force_n[HAND == 0].max() < 0.1e-3
    made.run(4, 2400 * rate_n)
    assert near(made.zero.force_n, 0.0)


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
