"""The temporal filter: sums averaged over cycles, with a gain that follows the motion.

ȳ ← ȳ + g (y - ȳ) reduces noise, but lags behind motion. The gain g is adapted from the innovations y - ȳ; the sensor's
noise need not be known:

* While the touch moves, ȳ lags, and successive innovations are correlated. While the touch rests, they are not. The
  gain rises and falls with the correlation of successive innovations over all sums, as Mehra (1970) adapts a Kalman
  filter.
* A sudden change makes the innovation much larger than the noise floor. Then the gain goes to 1 at once.

A missing sum keeps its average; its weight is multiplied by 1 - g in each cycle. So old sums vanish quickly while the
touch moves.
"""

import numpy as np
import numpy.typing as npt

from reconstructor.checks import Values
from reconstructor.kernels.temporal_filter import CORRELATION_GAIN, FLOOR, GAIN, SURPRISE, FilterState, update


class TemporalFilter:
    """Averaged sums of one stream of measurements.

    Parameters
    ----------
    sums : int
        m.
    averages : bool
        False for sums that come averaged: they are taken as they come, with a gain of 1. The noise floor is then that
        of their differences from cycle to cycle.
    """

    def __init__(self, sums: int, dtype: npt.DTypeLike, *, averages: bool = True) -> None:
        self._averages = averages
        kind = np.dtype(dtype)
        self._filtered = FilterState(np.zeros(sums, kind), np.zeros(sums, kind), np.zeros(sums, kind), np.zeros(4))
        self.reset()

    @property
    def sums(self) -> Values:
        """Averaged sums ȳ in newtons, shape (m,); a view."""
        return self._filtered.sums

    @property
    def weights(self) -> Values:
        """Weight of each sum, 0 to 1, shape (m,); a view."""
        return self._filtered.weights

    @property
    def gain(self) -> float:
        """The gain g of the last cycle, 0 to 1."""
        return float(self._filtered.state[GAIN])

    @property
    def noise_ratio(self) -> float:
        """Noise of ȳ / noise of y (standard deviations), √(g / (2 - g))."""
        return float((self.gain / (2 - self.gain)) ** 0.5)

    @property
    def noise_n(self) -> float:
        """Standard deviation of the noise of the sums of one cycle: root of the noise floor, 0 while unknown."""
        return float(self._filtered.state[FLOOR] ** 0.5)

    @property
    def surprise(self) -> float:
        """Root mean square of the last innovation over that of noise alone; 1 before there is any."""
        return float(self._filtered.state[SURPRISE] ** 0.5)

    def take(self, sums_n: Values, valid: npt.NDArray[np.bool_]) -> bool:
        """Process one cycle, arrays of shape (m,); return False, without a change, if a valid sum is not finite."""
        return bool(update(self._filtered, sums_n, valid, self._averages))

    def reset(self) -> None:
        """Drop all sums; keep the noise floor, because the sensor is the same."""
        for each in (self._filtered.sums, self._filtered.weights, self._filtered.innovation):
            each[:] = 0
        state = self._filtered.state
        state[CORRELATION_GAIN] = state[GAIN] = state[SURPRISE] = 1.0

    def restart(self) -> None:
        """Return to the state after construction."""
        self.reset()
        self._filtered.state[FLOOR] = 0.0
