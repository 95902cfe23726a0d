"""The offsets of sums followed while they drift."""

import numpy as np
import pytest

from calibration.drift import LONGEST_GAP, LONGEST_HELD, MEMORY, DriftFollower, line_through

SUMS, BLOCKS, NOISE_N = 400, 100, 1e-4
BLOCK_OF_SUM = np.arange(SUMS) // 4
ALL, NO_BLOCK = np.ones(SUMS, np.bool_), np.zeros(BLOCKS, np.bool_)


def follower(known: np.ndarray = ALL) -> DriftFollower:
    nothing = np.zeros(SUMS)
    return DriftFollower(BLOCK_OF_SUM, BLOCKS, nothing, nothing, known, age=8, noise_n=NOISE_N, least_noise_n=1e-6)


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, NOISE_N, SUMS)


def test_without_drift_the_offsets_stay() -> None:
    mine = follower()
    for k in range(100):
        mine.take(noise(k), ALL, NO_BLOCK)
    assert np.std(mine.level_n) < 0.5 * NOISE_N
    assert np.std(mine.slope_n) * MEMORY < 0.2 * NOISE_N
    assert mine.noise_n == pytest.approx(NOISE_N, rel=0.15)


@pytest.mark.parametrize("begins", [0, 60])
def test_a_drift_is_followed_without_lag(begins: int) -> None:
    mine, rate_n = follower(), np.random.default_rng(5).normal(0, 20 * NOISE_N, SUMS)
    for k in range(120):
        drifted = rate_n * max(0, k - begins)
        mine.take(drifted + noise(k), ALL, NO_BLOCK)
    assert np.std(mine.level_n - drifted) < NOISE_N
    assert np.std(mine.slope_n - rate_n) < 0.1 * NOISE_N


def test_under_a_touch_offsets_go_on_along_their_slopes() -> None:
    mine, rate_n = follower(), np.random.default_rng(5).normal(0, 5 * NOISE_N, SUMS)
    held = np.arange(SUMS // 4) < 30
    for k in range(100):
        touch_n = np.where(held[BLOCK_OF_SUM], 1e-2, 0) if k >= 60 else 0
        mine.take(rate_n * k + noise(k) + touch_n, ALL, held if k >= 60 else NO_BLOCK)
    assert np.std(mine.level_n - 99 * rate_n) < 3 * NOISE_N
    for _ in range(2 * LONGEST_HELD):  # not for ever
        mine.take(noise(0), ALL, ~NO_BLOCK)
    stopped = mine.level_n.copy()
    mine.take(noise(0), ALL, ~NO_BLOCK)
    assert (mine.level_n == stopped).all()


def test_a_sum_without_offset_waits_for_its_zero() -> None:
    of_first = BLOCK_OF_SUM == 0
    mine = follower(~of_first)
    offset_n = np.full(SUMS, 3e-3) * of_first
    mine.take(noise(0) + offset_n, ALL, NO_BLOCK)
    assert not mine.known[:4].any()
    mine.begin(of_first, offset_n, np.zeros(SUMS), 8)
    for k in range(20):
        mine.take(noise(k) + offset_n, ALL, NO_BLOCK)
    assert mine.known.all()
    assert mine.level_n[:4] == pytest.approx(np.full(4, 3e-3), abs=3 * NOISE_N)


def test_offsets_stop_after_the_longest_hold_whoever_asks() -> None:
    rate_n = np.random.default_rng(5).normal(0, 5 * NOISE_N, SUMS)
    mine = follower()
    for k in range(60):
        mine.take(rate_n * k + noise(k), ALL, NO_BLOCK)
    last = mine.predicted_n(LONGEST_HELD)
    np.testing.assert_array_equal(mine.predicted_n(100 * LONGEST_HELD), last)
    mine.skip(LONGEST_HELD // 2)
    np.testing.assert_allclose(mine.predicted_n(100 * LONGEST_HELD), last)
    mine.skip(LONGEST_HELD)
    np.testing.assert_allclose(mine.level_n, last)
    np.testing.assert_array_equal(mine.predicted_n(100), mine.level_n)


def test_line_through_points_of_which_one_is_wrong() -> None:
    points = np.outer(np.arange(8), [1.0, -2.0]) + np.array([5.0, 7.0])
    points[3] = 1e3
    level, slope, _ = line_through(points)
    assert level == pytest.approx([12.0, -7.0])
    assert slope == pytest.approx([1.0, -2.0])


@pytest.mark.parametrize("known_windows", [8, 100])
def test_a_drift_is_followed_through_gaps(known_windows: int) -> None:
    """Four windows after every sixty: offsets stay near the drift, however well it was known before the first gap."""
    mine, rate_n = follower(), np.random.default_rng(5).normal(0, 0.1 * NOISE_N, SUMS)
    time, worst = 0, list[float]()
    for gap in (0, *[LONGEST_GAP] * 30):
        mine.skip(gap) if gap else None
        time += gap
        for _ in range(4 if gap else known_windows):
            time += 1
            mine.take(rate_n * time + noise(time), ALL, NO_BLOCK)
        worst.append(float(np.std(mine.predicted_n(LONGEST_GAP) - rate_n * (time + LONGEST_GAP))))
    assert max(worst) < 0.1 * NOISE_N * LONGEST_GAP
    assert max(worst[5:]) < 2 * NOISE_N


def test_a_drift_that_changes_in_a_gap_is_followed() -> None:
    mine, rate_n = follower(), np.random.default_rng(5).normal(0, NOISE_N, SUMS)
    drifted, errors_n = np.zeros(SUMS), list[float]()
    for turn in range(20):
        rate = rate_n if turn < 10 else -rate_n
        mine.skip(LONGEST_GAP)
        drifted = drifted + LONGEST_GAP * rate
        for k in range(4):
            drifted = drifted + rate
            mine.take(drifted + noise(10 * turn + k), ALL, NO_BLOCK)
        errors_n.append(float(np.std(mine.level_n - drifted)))
    assert max(errors_n[9], errors_n[19]) < 2 * NOISE_N
    assert max(errors_n[10:]) < 0.1 * NOISE_N * LONGEST_GAP
