"""The offsets of sums, followed while they drift: level, slope and noise are those of a slow computation."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from calibration.calibrator import LONGEST_GAP
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
    for _ in range(2 * MEMORY):  # not for ever
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


#: Three blocks of two sums.
BLOCK_OF_FEW = np.array([0, 0, 1, 1, 2, 2])
FEW, FEW_BLOCKS = 6, 3
ALL_FEW = np.ones(FEW, np.bool_)
FREE = np.zeros(FEW_BLOCKS, np.bool_)
LEAST_N = 1e-5


def covariance(points: int) -> Floats:
    """Return that of level, at the newest point, and slope of a least-squares line, in units of a point's variance."""
    if points == 1:
        return np.diag([1.0, 1e6])  # nothing is known of the slope
    design = np.stack([np.ones(points), np.arange(points) - points + 1.0], axis=1)
    return np.asarray(np.linalg.inv(design.T @ design), np.float64)


class SlowFollower:
    """Kalman's filter for each block, with matrices; offsets of all sums are known."""

    def __init__(self, level_n: Floats, slope_n: Floats, age: int, noise_n: float) -> None:
        self.level_n, self.raw_n, self.noise_n = level_n.copy(), slope_n.copy(), max(noise_n, LEAST_N)
        self.age, self.held, self.late = [age] * FEW_BLOCKS, [0] * FEW_BLOCKS, [False] * FEW_BLOCKS
        self.spread = [covariance(age) for _ in range(FEW_BLOCKS)]

    def slope_n(self) -> Floats:
        """Return James and Stein's part of the slopes: what is more than noise."""
        tell = [each for each in range(FEW) if self.age[BLOCK_OF_FEW[each]] > 1]
        if not tell:
            return np.zeros(FEW)
        noise_n2 = sum(self.noise_n**2 * self.spread[BLOCK_OF_FEW[each]][1, 1] for each in tell) / len(tell)
        factor = max(0.0, 1 - noise_n2 / (sum(self.raw_n[each] ** 2 for each in tell) / len(tell)))
        goes_on = [self.age[block] > 1 and self.held[block] < self.age[block] for block in BLOCK_OF_FEW]
        return np.where(goes_on, factor * self.raw_n, 0.0)

    def predicted_n(self, windows: int) -> Floats:
        left = [min(windows, max(0, self.age[block] - self.held[block])) for block in BLOCK_OF_FEW]
        return self.level_n + np.array(left) * self.slope_n()

    @staticmethod
    def moved(spread: Floats, windows: int) -> Floats:
        forward = np.array([[1.0, windows], [0.0, 1.0]])
        return forward @ spread @ forward.T

    def skip(self, windows: int) -> None:
        self.level_n = self.predicted_n(windows)
        for block in range(FEW_BLOCKS):
            self.spread[block] = self.moved(self.spread[block], windows)
            self.late[block] = True
            self.held[block] += windows

    def take(self, mean_n: Floats, known: Bools, held: Bools) -> None:
        seen = [bool(known[each]) and not held[BLOCK_OF_FEW[each]] for each in range(FEW)]
        held_n, late, others = self.predicted_n(1), list[float](), list[float]()
        ahead_n = held_n.copy()
        for each in np.flatnonzero(seen).tolist():
            block = BLOCK_OF_FEW[each]
            is_line = self.age[block] > 1
            ahead_n[each] = self.level_n[each] + (self.raw_n[each] if is_line else 0.0)
            deviation = (1 + (self.moved(self.spread[block], 1)[0, 0] if is_line else 5.0)) ** 0.5
            (late if self.late[block] else others).append((mean_n[each] - ahead_n[each]) / deviation)
        if late:
            surprise = sum(each**2 for each in late) / len(late) / self.noise_n**2
            self.spread = [
                max(1.0, surprise) * spread if is_late else spread
                for spread, is_late in zip(self.spread, self.late, strict=True)
            ]
        if others:
            square = sum(min(each**2, 36 * self.noise_n**2) for each in others) / len(others)
            if square > 1.69 * self.noise_n**2:
                self.age = [min(age, max(age // 2, 4)) for age in self.age]
                self.spread = [
                    np.maximum(spread, covariance(age)) for spread, age in zip(self.spread, self.age, strict=True)
                ]
            variance = self.noise_n**2
            self.noise_n = max(LEAST_N, (variance + 0.05 * (min(square, 4 * variance) - variance)) ** 0.5)
        for block in range(FEW_BLOCKS):
            mine = [each for each in range(FEW) if BLOCK_OF_FEW[each] == block and seen[each]]
            if not mine:
                self.held[block] += 1
                continue
            before = self.moved(self.spread[block], 1)
            gain = before[:, 0] / (1 + before[0, 0])
            after = before - np.outer(gain, before[0])
            self.spread[block] = np.maximum(after, covariance(40))
            for each in mine:
                residual_n = mean_n[each] - ahead_n[each]
                ahead_n[each] += self.spread[block][0, 0] * residual_n
                self.raw_n[each] += self.spread[block][0, 1] * residual_n
            self.age[block] = min(self.age[block] + 1, 40)
            self.late[block], self.held[block] = False, 0
        self.level_n = ahead_n


def both(age: int, noise_n: float, seed: int = 0) -> tuple[DriftFollower, SlowFollower]:
    random = np.random.default_rng(seed)
    level_n, slope_n = random.normal(0, 1e-2, FEW), random.normal(0, 1e-4, FEW)
    made = DriftFollower(
        BLOCK_OF_FEW, FEW_BLOCKS, level_n, slope_n, ALL_FEW, age=age, noise_n=noise_n, least_noise_n=LEAST_N
    )
    return made, SlowFollower(level_n, slope_n, age, noise_n)


def same(made: DriftFollower, slow: SlowFollower) -> None:
    assert made.level_n == pytest.approx(slow.level_n, rel=1e-9, abs=1e-12)
    assert made.slope_n == pytest.approx(slow.slope_n(), rel=1e-7, abs=1e-12)
    assert made.noise_n == pytest.approx(slow.noise_n, rel=1e-9)
    for windows in (1, 7, 300):
        assert made.predicted_n(windows) == pytest.approx(slow.predicted_n(windows), rel=1e-7, abs=1e-12)


def windows(count: int, noise_n: float, seed: int) -> Iterator[Floats]:
    """Yield the means of windows of a skin whose drift turns round in the middle."""
    random = np.random.default_rng(seed)
    rate_n = random.normal(0, 3e-4, FEW)
    offset_n = np.zeros(FEW)
    for each in range(count):
        offset_n = offset_n + (rate_n if each < count / 2 else -rate_n)
        yield offset_n + random.normal(0, noise_n, FEW)


@pytest.mark.parametrize("age", [1, 2, 8, 40])
@pytest.mark.parametrize("noise_n", [1e-4, 3e-6])
def test_offsets_and_noise_are_those_of_kalman_s_filter(age: int, noise_n: float) -> None:
    made, slow = both(age, noise_n)
    same(made, slow)
    for turn, mean_n in enumerate(windows(90, noise_n, seed=age)):
        made.take(mean_n, ALL_FEW, FREE)
        slow.take(mean_n, ALL_FEW, FREE)
        if turn % 10 == 9:
            same(made, slow)


@pytest.mark.parametrize("noise_n", [2e-5, 1e-3])
def test_touches_gaps_and_missing_sums_are_those_of_kalman_s_filter(noise_n: float) -> None:
    made, slow = both(8, noise_n)
    random = np.random.default_rng(5)
    for turn, mean_n in enumerate(windows(150, noise_n, seed=6)):
        held, known = random.random(FEW_BLOCKS) < 0.3, random.random(FEW) < 0.8
        if turn == 90:
            for each in (made, slow):
                each.skip(100)
        elif turn % 9 == 8:
            for each in (made, slow):
                each.skip(3)
        made.take(mean_n, known, held)
        slow.take(mean_n, known, held)
        if turn % 10 == 3:
            same(made, slow)


def test_a_block_that_is_held_stops_and_the_others_go_on() -> None:
    made, slow = both(8, 1e-5)
    held = np.array([False, True, False])
    for mean_n in windows(250, 1e-5, seed=3):
        made.take(mean_n, ALL_FEW, held)
        slow.take(mean_n, ALL_FEW, held)
    same(made, slow)
    slopes_n = made.slope_n
    assert not slopes_n[2:4].any()
    assert slopes_n[[0, 1, 4, 5]].all()


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


def test_a_slope_that_may_be_noise_is_none_and_a_part_of_a_larger_one_is() -> None:
    """The variance of the slope of a line through n points is 12 / (n (n² - 1)) times that of a point."""
    slope_n = np.array([1e-4, -2e-4, 3e-4, 1e-4, 0, 5.0])
    known = np.array([True] * 5 + [False])
    made = [
        DriftFollower(BLOCK_OF_FEW, FEW_BLOCKS, np.zeros(FEW), slope_n, known, age=8, noise_n=each, least_noise_n=1e-6)
        for each in (1e-4, 1e-2)
    ]
    part = 1 - 1e-8 * (12 / (8 * 63)) / (15e-8 / 5)
    assert made[0].slope_n == pytest.approx(part * slope_n * known)
    assert made[0].predicted_n(2.5) == pytest.approx(2.5 * part * slope_n * known)
    assert not made[1].slope_n.any()
    one = DriftFollower(BLOCK_OF_FEW, FEW_BLOCKS, slope_n, slope_n, known, age=1, noise_n=1e-9, least_noise_n=1e-9)
    assert not one.slope_n.any()
    assert one.predicted_n(3).tolist() == slope_n.tolist()


def test_a_block_begins_anew_with_the_line_it_is_given() -> None:
    made, _ = both(40, 1e-4)
    nothing, level_n, slope_n = np.zeros(FEW), np.full(FEW, 0.5), np.full(FEW, 1e-3)
    made.skip(30)
    made.begin(BLOCK_OF_FEW == 1, level_n, slope_n, 8)
    fresh = DriftFollower(
        BLOCK_OF_FEW, FEW_BLOCKS, nothing, nothing, ALL_FEW, age=40, noise_n=1e-4, least_noise_n=LEAST_N
    )
    fresh.skip(30)
    fresh.begin(BLOCK_OF_FEW == 1, level_n, slope_n, 8)
    mine = slice(2, 4)
    assert made.level_n[mine].tolist() == [0.5, 0.5]
    for mean_n in windows(8, 1e-4, seed=2):
        made.take(mean_n, ALL_FEW, ~FREE)
    assert made.level_n[mine] == pytest.approx(0.508, rel=1e-4)
    made.take(nothing, ALL_FEW, ~FREE)
    assert made.level_n[mine] == pytest.approx(0.508, rel=1e-4)  # no further than the line was long
    assert not made.slope_n[mine].any()
    assert made.slope_n[[0, 1, 4, 5]].all()
    after = np.full(FEW, 0.5011)  # no surprise
    fresh.take(after, ALL_FEW, np.array([True, False, True]))
    # The ninth point of a line: 2 (2 n - 1) / (n (n + 1)) of the difference.
    assert fresh.level_n[mine] == pytest.approx(0.501 + 34 / 90 * (0.5011 - 0.501))
    # No gap lies between its line and this point, whose noise is learned: one point ahead, a line of 8 has the variance
    # 30 / 72 + 12 / 72 + 12 / 504 of a point.
    assert fresh.noise_n == pytest.approx(1e-4 * (1 + 0.05 * (1 / (1 + 42 / 72 + 12 / 504) - 1)) ** 0.5)


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


def test_of_the_second_window_little_is_foreseen() -> None:
    """Its distance from the first is expected to have six times the variance of a window: there may be a drift."""
    nothing = np.zeros(FEW)
    made = DriftFollower(BLOCK_OF_FEW, FEW_BLOCKS, nothing, nothing, ALL_FEW, age=1, noise_n=1e-3, least_noise_n=1e-6)
    made.take(np.full(FEW, 1.5e-3), ALL_FEW, FREE)
    assert made.noise_n == pytest.approx(1e-3 * (1 + 0.05 * (1.5**2 / 6 - 1)) ** 0.5)


def test_one_sum_that_jumps_tells_of_six_times_the_noise_at_most() -> None:
    blocks = np.arange(100)
    nothing, known = np.zeros(100), np.ones(100, np.bool_)
    made = DriftFollower(blocks, 100, nothing, nothing, known, age=8, noise_n=1e-3, least_noise_n=1e-6)
    made.take(np.where(blocks == 7, 1.0, 0.0), known, ~known)
    # All others are where they were foreseen: the mean square is 36 / 100 of the noise's.
    assert made.noise_n == pytest.approx(1e-3 * (1 + 0.05 * (0.36 - 1)) ** 0.5)
    made.take(np.zeros(100), known, np.where(blocks == 7, True, False))
    assert made.noise_n == pytest.approx(1e-3 * (1 + 0.05 * (0.36 - 1)) ** 0.5 * 0.95**0.5)


def test_deviation_from_a_line_has_two_points_fewer() -> None:
    points = np.array([[0.0], [1.0], [2.0], [3.0], [4.5]])
    level, slope, deviation = line_through(points)
    assert slope.tolist() == [1.0]
    assert level.tolist() == [4.0]
    assert deviation == pytest.approx([(0.25 / 3) ** 0.5])
