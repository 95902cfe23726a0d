"""The line through the means of windows, as a slow computation with matrices has it: level, slope and noise."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from calibration.drift import DriftFollower, line_through

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

#: Three blocks of two sums.
BLOCK_OF_SUM = np.array([0, 0, 1, 1, 2, 2])
SUMS, BLOCKS = 6, 3
ALL = np.ones(SUMS, np.bool_)
FREE = np.zeros(BLOCKS, np.bool_)
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
        self.age, self.held, self.late = [age] * BLOCKS, [0] * BLOCKS, [False] * BLOCKS
        self.spread = [covariance(age) for _ in range(BLOCKS)]

    def slope_n(self) -> Floats:
        """Return James and Stein's part of the slopes: what is more than noise."""
        tell = [each for each in range(SUMS) if self.age[BLOCK_OF_SUM[each]] > 1]
        if not tell:
            return np.zeros(SUMS)
        noise_n2 = sum(self.noise_n**2 * self.spread[BLOCK_OF_SUM[each]][1, 1] for each in tell) / len(tell)
        factor = max(0.0, 1 - noise_n2 / (sum(self.raw_n[each] ** 2 for each in tell) / len(tell)))
        goes_on = [self.age[block] > 1 and self.held[block] < 240 for block in BLOCK_OF_SUM]
        return np.where(goes_on, factor * self.raw_n, 0.0)

    def predicted_n(self, windows: int) -> Floats:
        left = [min(windows, max(0, 240 - self.held[block])) for block in BLOCK_OF_SUM]
        return self.level_n + np.array(left) * self.slope_n()

    @staticmethod
    def moved(spread: Floats, windows: int) -> Floats:
        forward = np.array([[1.0, windows], [0.0, 1.0]])
        return forward @ spread @ forward.T

    def skip(self, windows: int) -> None:
        self.level_n = self.predicted_n(windows)
        for block in range(BLOCKS):
            self.spread[block] = self.moved(self.spread[block], windows)
            self.late[block] = True
            self.held[block] += windows

    def take(self, mean_n: Floats, known: Bools, held: Bools) -> None:
        seen = [bool(known[each]) and not held[BLOCK_OF_SUM[each]] for each in range(SUMS)]
        held_n, late, others = self.predicted_n(1), list[float](), list[float]()
        ahead_n = held_n.copy()
        for each in np.flatnonzero(seen).tolist():
            block = BLOCK_OF_SUM[each]
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
        for block in range(BLOCKS):
            mine = [each for each in range(SUMS) if BLOCK_OF_SUM[each] == block and seen[each]]
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
    level_n, slope_n = random.normal(0, 1e-2, SUMS), random.normal(0, 1e-4, SUMS)
    made = DriftFollower(BLOCK_OF_SUM, BLOCKS, level_n, slope_n, ALL, age=age, noise_n=noise_n, least_noise_n=LEAST_N)
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
    rate_n = random.normal(0, 3e-4, SUMS)
    offset_n = np.zeros(SUMS)
    for each in range(count):
        offset_n = offset_n + (rate_n if each < count / 2 else -rate_n)
        yield offset_n + random.normal(0, noise_n, SUMS)


@pytest.mark.parametrize("age", [1, 2, 8, 40])
@pytest.mark.parametrize("noise_n", [1e-4, 3e-6])
def test_offsets_and_noise_are_those_of_kalman_s_filter(age: int, noise_n: float) -> None:
    made, slow = both(age, noise_n)
    same(made, slow)
    for turn, mean_n in enumerate(windows(90, noise_n, seed=age)):
        made.take(mean_n, ALL, FREE)
        slow.take(mean_n, ALL, FREE)
        if turn % 10 == 9:
            same(made, slow)


@pytest.mark.parametrize("noise_n", [2e-5, 1e-3])
def test_touches_gaps_and_missing_sums_are_those_of_kalman_s_filter(noise_n: float) -> None:
    made, slow = both(8, noise_n)
    random = np.random.default_rng(5)
    for turn, mean_n in enumerate(windows(150, noise_n, seed=6)):
        held, known = random.random(BLOCKS) < 0.3, random.random(SUMS) < 0.8
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


def test_a_block_that_is_held_stops_after_240_windows_alone() -> None:
    made, slow = both(8, 1e-5)
    held = np.array([False, True, False])
    for mean_n in windows(250, 1e-5, seed=3):
        made.take(mean_n, ALL, held)
        slow.take(mean_n, ALL, held)
    same(made, slow)
    slopes_n = made.slope_n
    assert not slopes_n[2:4].any()
    assert slopes_n[[0, 1, 4, 5]].all()


def test_the_first_forty_windows_of_one_block_give_its_least_squares_line() -> None:
    noise_n = 0.1  # more than there is: nothing is surprising
    nothing = np.zeros(SUMS)
    made = DriftFollower(BLOCK_OF_SUM, BLOCKS, nothing, nothing, ~ALL, age=1, noise_n=noise_n, least_noise_n=noise_n)
    first = BLOCK_OF_SUM == 0
    points = np.array(list(windows(40, 1e-4, seed=8)))
    made.begin(first, points[0], nothing, 1)
    for count in range(2, 41):
        made.take(points[count - 1], ALL, FREE)
        line = np.polyfit(np.arange(count) - count + 1, points[:count, :2], 1)
        assert made.level_n[:2] == pytest.approx(line[1], rel=1e-4, abs=1e-8)
        assert not made.level_n[2:].any()
    assert made.known.tolist() == first.tolist()


def test_a_slope_that_may_be_noise_is_none_and_a_part_of_a_larger_one_is() -> None:
    """The variance of the slope of a line through n points is 12 / (n (n² - 1)) times that of a point."""
    slope_n = np.array([1e-4, -2e-4, 3e-4, 1e-4, 0, 5.0])
    known = np.array([True] * 5 + [False])
    made = [
        DriftFollower(BLOCK_OF_SUM, BLOCKS, np.zeros(SUMS), slope_n, known, age=8, noise_n=each, least_noise_n=1e-6)
        for each in (1e-4, 1e-2)
    ]
    part = 1 - 1e-8 * (12 / (8 * 63)) / (15e-8 / 5)
    assert made[0].slope_n == pytest.approx(part * slope_n * known)
    assert made[0].predicted_n(2.5) == pytest.approx(2.5 * part * slope_n * known)
    assert not made[1].slope_n.any()
    one = DriftFollower(BLOCK_OF_SUM, BLOCKS, slope_n, slope_n, known, age=1, noise_n=1e-9, least_noise_n=1e-9)
    assert not one.slope_n.any()
    assert one.predicted_n(3).tolist() == slope_n.tolist()


def test_a_block_begins_anew_with_the_line_it_is_given() -> None:
    made, _ = both(40, 1e-4)
    nothing, level_n, slope_n = np.zeros(SUMS), np.full(SUMS, 0.5), np.full(SUMS, 1e-3)
    made.skip(230)
    made.begin(BLOCK_OF_SUM == 1, level_n, slope_n, 8)
    fresh = DriftFollower(BLOCK_OF_SUM, BLOCKS, nothing, nothing, ALL, age=40, noise_n=1e-4, least_noise_n=LEAST_N)
    fresh.skip(230)
    fresh.begin(BLOCK_OF_SUM == 1, level_n, slope_n, 8)
    mine = slice(2, 4)
    assert made.level_n[mine].tolist() == [0.5, 0.5]
    for mean_n in windows(30, 1e-4, seed=2):
        made.take(mean_n, ALL, ~FREE)
    # 30 windows under a touch: the others have come to their 240th, this block has not.
    assert made.level_n[mine] == pytest.approx(0.5 + 30 * made.slope_n[mine])
    assert made.slope_n[mine].all()
    assert not made.slope_n[[0, 1, 4, 5]].any()
    after = np.full(SUMS, 0.5011)  # no surprise
    fresh.take(after, ALL, np.array([True, False, True]))
    # The ninth point of a line: 2 (2 n - 1) / (n (n + 1)) of the difference.
    assert fresh.level_n[mine] == pytest.approx(0.501 + 34 / 90 * (0.5011 - 0.501))
    # No gap lies between its line and this point, whose noise is learned: one point ahead, a line of 8 has the variance
    # 30 / 72 + 12 / 72 + 12 / 504 of a point.
    assert fresh.noise_n == pytest.approx(1e-4 * (1 + 0.05 * (1 / (1 + 42 / 72 + 12 / 504) - 1)) ** 0.5)


def test_of_the_second_window_little_is_foreseen() -> None:
    """Its distance from the first is expected to have six times the variance of a window: there may be a drift."""
    nothing = np.zeros(SUMS)
    made = DriftFollower(BLOCK_OF_SUM, BLOCKS, nothing, nothing, ALL, age=1, noise_n=1e-3, least_noise_n=1e-6)
    made.take(np.full(SUMS, 1.5e-3), ALL, FREE)
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
