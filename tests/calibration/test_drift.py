"""The offsets of sums, followed while they drift: level, slope and noise are those of a slow computation."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from calibration.drift import MEMORY, DriftFollower, line_through

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

SUMS, BLOCKS, NOISE_N = 400, 100, 1e-4
BLOCK_OF_SUM = np.arange(SUMS) // 4
ALL, NO_BLOCK = np.ones(SUMS, np.bool_), np.zeros(BLOCKS, np.bool_)


def follower(known: np.ndarray = ALL) -> DriftFollower:
    nothing = np.zeros(SUMS)
    return DriftFollower(BLOCK_OF_SUM, BLOCKS, nothing, nothing, known, age=8, noise_n=NOISE_N, least_noise_n=1e-6)


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, NOISE_N, SUMS)


@pytest.mark.parametrize("begins", [0, 60])
def test_a_drift_is_followed_without_lag(begins: int) -> None:
    mine, rate_n = follower(), np.random.default_rng(5).normal(0, 20 * NOISE_N, SUMS)
    for k in range(120):
        drifted = rate_n * max(0, k - begins)
        mine.take(drifted + noise(k), ALL, NO_BLOCK)
    assert np.std(mine.level_n - drifted) < NOISE_N
    assert np.std(mine.slope_n - rate_n) < 0.1 * NOISE_N


def test_offsets_stop_after_as_many_windows_as_their_line_has_whoever_asks() -> None:
    rate_n = np.random.default_rng(5).normal(0, 5 * NOISE_N, SUMS)
    mine = follower()
    for k in range(60):
        mine.take(rate_n * k + noise(k), ALL, NO_BLOCK)
    last = mine.predicted_n(MEMORY)
    np.testing.assert_array_equal(mine.predicted_n(100 * MEMORY), last)
    mine.skip(MEMORY // 2)
    np.testing.assert_allclose(mine.predicted_n(100 * MEMORY), last)
    mine.skip(MEMORY)
    np.testing.assert_allclose(mine.level_n, last)
    np.testing.assert_array_equal(mine.predicted_n(100), mine.level_n)


def test_the_first_window_after_a_gap_moves_the_level_further_the_longer_the_gap() -> None:
    moved = []
    for gap in (0, 4, 40):
        mine = follower()
        for k in range(60):
            mine.take(noise(k), ALL, NO_BLOCK)
        mine.skip(gap)
        before_n = mine.level_n
        mine.take(mine.level_n + NOISE_N, ALL, NO_BLOCK)
        moved.append((mine.level_n - before_n).mean() / NOISE_N)
    assert moved[0] < moved[1] < moved[2]
    assert moved[2] > 0.35


def test_line_through_points_of_which_one_is_wrong() -> None:
    points = np.outer(np.arange(8), [1.0, -2.0]) + np.array([5.0, 7.0])
    points[3] = 1e3
    level, slope, _ = line_through(points)
    assert level == pytest.approx([12.0, -7.0])
    assert slope == pytest.approx([1.0, -2.0])


#: Three blocks of two sums.
BLOCK_OF_FEW = np.array([0, 0, 1, 1, 2, 2])
FEW, FEW_BLOCKS = 6, 3
ALL_FEW = np.ones(FEW, np.bool_)
FREE = np.zeros(FEW_BLOCKS, np.bool_)
LEAST_N = 1e-5


def windows(count: int, noise_n: float, seed: int) -> Iterator[Floats]:
    """Yield the means of windows of a skin whose drift turns round in the middle."""
    random = np.random.default_rng(seed)
    rate_n = random.normal(0, 3e-4, FEW)
    offset_n = np.zeros(FEW)
    for each in range(count):
        offset_n = offset_n + (rate_n if each < count / 2 else -rate_n)
        yield offset_n + random.normal(0, noise_n, FEW)


def test_the_first_forty_windows_of_one_block_give_its_least_squares_line() -> None:
    noise_n = 0.1  # more than there is: nothing is surprising
    nothing = np.zeros(FEW)
    made = DriftFollower(
        BLOCK_OF_FEW, FEW_BLOCKS, nothing, nothing, ~ALL_FEW, age=1, noise_n=noise_n, least_noise_n=noise_n
    )
    first = BLOCK_OF_FEW == 0
    points = np.array(list(windows(40, 1e-4, seed=8)))
    made.begin(first, points[0], nothing, 1)
    for count in range(2, 41):
        made.take(points[count - 1], ALL_FEW, FREE)
        line = np.polyfit(np.arange(count) - count + 1, points[:count, :2], 1)
        assert made.level_n[:2] == pytest.approx(line[1], rel=1e-4, abs=1e-8)
        assert not made.level_n[2:].any()
    assert made.known.tolist() == first.tolist()


def test_the_first_window_after_offsets_of_another_time_is_their_first_point() -> None:
    """However far they are off, that is no slope: a zero that was stored does not run on under the next touch."""
    nothing, first_n = np.zeros(FEW), np.full(FEW, 5e-3)
    made = DriftFollower(
        BLOCK_OF_FEW, FEW_BLOCKS, nothing, nothing, ALL_FEW, age=0, noise_n=1e-5, least_noise_n=LEAST_N
    )
    for _ in range(3):
        made.take(first_n, ALL_FEW, FREE)
        assert made.level_n == pytest.approx(first_n)
        assert not made.slope_n.any()
