"""The offset of every sum, followed while it drifts: a level and a slope, from the means of windows."""

from typing import Final

import numpy as np
import numpy.typing as npt

from calibration.windows import Bools, Floats

#: Windows through which the line of the drift is drawn; after a start through as many as there are.
MEMORY: Final = 40
#: Fewest windows, after a drift has changed.
SHORTEST_MEMORY: Final = 4
#: The drift has changed when the offsets are off by `CHANGED` times their noise, root mean square over all sums.
CHANGED: Final = 1.3
#: The noise of the means follows them by this part of the difference.
NOISE_GAIN: Final = 0.05

#: Variance of what the first window foresees of the second, in units of that of one window.
_SECOND: Final = 5.0
#: Variance of a level that was moved: what is measured next moves the level, and hardly the slope.
_MOVED: Final = 10.0
#: Variance of a slope that nothing is known of, in units of that of one window.
_ANY_SLOPE: Final = 1e6

Ages = npt.NDArray[np.intp]


class DriftFollower:
    """Offsets of sums. Times are counted in windows, from the centre of the newest.

    Parameters
    ----------
    block_of_sum : array of int, shape (m,)
    blocks : int
        Number of blocks.
    level_n, slope_n : array, shape (m,)
        Offsets in newtons, and their change in a window.
    known : array of bool, shape (m,)
        False for sums without an offset so far.
    age : int
        Number of windows that the line was drawn through; 0 if the offsets are of another time.
    noise_n : float
        Standard deviation of the mean of a window.
    least_noise_n : float
        No noise is taken to be less.
    """

    def __init__(
        self,
        block_of_sum: Ages,
        blocks: int,
        level_n: Floats,
        slope_n: Floats,
        known: Bools,
        *,
        age: int,
        noise_n: float,
        least_noise_n: float,
    ) -> None:
        self.level_n, self.known = level_n.copy(), known.copy()
        self.noise_n = max(noise_n, least_noise_n)
        self._slope_n = np.where(known, slope_n, 0.0)
        self._block_of_sum = block_of_sum
        self._age = np.full(blocks, age, np.intp)
        #: Variance of level, covariance, variance of slope of each block, in units of the noise's: the gains of a line.
        self._spread = _spread(self._age)
        self._least_spread = _spread(np.full(blocks, MEMORY))
        self._held = np.zeros_like(self._age)
        self._least_noise_n = least_noise_n

    @property
    def slope_n(self) -> Floats:
        """Drift of each sum in a window, as far as it is more than noise: of all sums together 0 if it is not."""
        square = self._slope_n**2
        of_sums = self.known & (self._age[self._block_of_sum] > 1)
        if not of_sums.any():
            return np.zeros_like(self._slope_n)
        expected = (self.noise_n**2 * self._spread[2, self._block_of_sum])[of_sums].mean()
        # James and Stein's factor: what is left of the slopes when the noise in them is taken off.
        factor = max(0.0, 1.0 - expected / max(float(square[of_sums].mean()), 1e-30))
        return np.where(of_sums & (self._left > 0), factor * self._slope_n, 0.0)

    def predicted_n(self, windows: float) -> Floats:
        """Return the offsets `windows` after the centre of the newest window, newtons.

        They go on for at most as many windows without a measurement as the line was drawn through: no offset runs
        further than its drift has been seen to.
        """
        left = self._left
        ahead = np.asarray(np.clip(windows, -left, left), np.float64)
        return self.level_n + ahead * self.slope_n

    def skip(self, windows: int) -> None:
        """Let the offsets go on along their slopes for windows in which nothing was measured: less certain levels."""
        self.level_n = self.predicted_n(windows)
        self._spread = _ahead(self._spread, windows)
        self._held = self._held + windows

    def begin(self, sums: Bools, level_n: Floats, slope_n: Floats, age: int) -> None:
        """Give sums of shape (m,), all those of some blocks, their first offsets: a line through `age` windows."""
        self.level_n = np.where(sums, level_n, self.level_n)
        self._slope_n = np.where(sums, slope_n, self._slope_n)
        self.known = self.known | sums
        blocks = np.unique(self._block_of_sum[sums])
        self._age[blocks], self._held[blocks] = age, 0
        self._spread[:, blocks] = _spread(self._age[blocks])

    def add(self, change_n: Floats) -> None:
        """Add to the offsets, shape (m,), newtons; they are as certain as before."""
        self.level_n = self.level_n + change_n

    def turn(self, change_n: Floats) -> None:
        """Add to the slopes, shape (m,), newtons in a window."""
        self._slope_n = np.where(self.known, self._slope_n + change_n, 0.0)

    @property
    def _left(self) -> Ages:
        """Windows for which each sum still goes on along its slope."""
        left: Ages = np.maximum(self._age - self._held, 0)[self._block_of_sum]
        return left

    def move(self, change_n: Floats) -> None:
        """Move the offsets at once by what is no drift, shape (m,), newtons; the slopes learn nothing of that."""
        self.add(change_n)
        moved = np.abs(change_n) > self.noise_n
        blocks = np.unique(self._block_of_sum[moved & self.known])
        self._spread[0, blocks] += _MOVED

    def take(self, mean_n: Floats, known: Bools, held: Bools) -> None:
        """Follow the means of the next window. Sums without an offset wait for `begin`.

        Parameters
        ----------
        mean_n : array, shape (m,)
            Of raw sums, newtons.
        known : array of bool, shape (m,)
            Sums that have a mean.
        held : array of bool, shape (blocks,)
            Blocks under a touch: their offsets go on along their slopes.
        """
        is_held = held[self._block_of_sum] | ~known
        own = self.level_n + np.where(self._age[self._block_of_sum] > 1, self._slope_n, 0.0)
        ahead = np.where(is_held, self.predicted_n(1.0), own)
        residual = mean_n - ahead
        follows = ~is_held & self.known
        deviation = np.sqrt(1.0 + np.where(self._age > 1, _ahead(self._spread)[0], _SECOND))
        relative = residual / deviation[self._block_of_sum]
        if follows.any():
            self._learn(relative[follows])
        age = np.minimum(self._age + 1, MEMORY)
        spread = np.maximum(_after_point(_ahead(self._spread)), self._least_spread)
        spread = np.where(age == 1, _spread(age), spread)  # the first window tells nothing of the slope
        level_gain, slope_gain = spread[:2, self._block_of_sum]
        self.level_n = np.where(follows, ahead + level_gain * residual, ahead)
        self._slope_n = np.where(follows, self._slope_n + slope_gain * residual, self._slope_n)
        followed = np.zeros_like(held)
        followed[self._block_of_sum[follows]] = True
        self._age = np.where(followed, age, self._age)
        self._spread = np.where(followed, spread, self._spread)
        self._held = np.where(followed, 0, self._held + 1)

    def _learn(self, residual_n: Floats) -> None:
        """Learn the noise from what the line did not foresee; shorten the memory when that is too much."""
        square = float(np.mean(np.minimum(residual_n**2, (6 * self.noise_n) ** 2)))
        if square > (CHANGED * self.noise_n) ** 2:
            self._age = np.minimum(self._age, np.maximum(self._age // 2, SHORTEST_MEMORY))
            self._spread = np.maximum(self._spread, _spread(self._age))
        noise_n = (self.noise_n**2 + NOISE_GAIN * (min(square, 4 * self.noise_n**2) - self.noise_n**2)) ** 0.5
        self.noise_n = max(noise_n, self._least_noise_n)


def _spread(age: Ages) -> Floats:
    """Return variance of level, covariance, and variance of slope of lines through `age` windows, shape (3, blocks).

    In units of the variance of one window; the level is that of the newest. One window tells nothing of the slope.
    """
    n = np.maximum(age, 2).astype(np.float64)
    spread = np.stack([2 * (2 * n - 1) / (n * (n + 1)), 6 / (n * (n + 1)), 12 / (n * (n * n - 1))])
    return np.asarray(np.where(age > 1, spread, [[1.0], [0.0], [_ANY_SLOPE]]), np.float64)


def _ahead(spread: Floats, windows: int = 1) -> Floats:
    """Return what `_spread` is of the level some windows later."""
    level, both, slope = spread
    return np.stack([level + windows * (2 * both + windows * slope), both + windows * slope, slope])


def _after_point(spread: Floats) -> Floats:
    """Return what `_spread` is with one more window at the time of the level (Kalman 1960)."""
    level, both, slope = spread
    after: Floats = np.stack([level, both, slope - both**2 + level * slope]) / (1 + level)
    return after


def line_through(means_n: Floats) -> tuple[Floats, Floats, Floats]:
    """Return level at the last point, slope, and deviation of each sum, of points shape (points, m), robustly.

    The slope is the median of the slopes between two points (Theil 1950, Sen 1968).
    """
    points = len(means_n)
    first, second = np.triu_indices(points, 1)
    slope = np.median((means_n[second] - means_n[first]) / (second - first)[:, None], axis=0)
    at = np.arange(points)[:, None]
    middle = np.median(means_n - slope * at, axis=0)
    deviation = np.sqrt(np.mean((means_n - middle - slope * at) ** 2, axis=0) * points / (points - 2))
    return middle + slope * (points - 1), slope, deviation
