"""What earlier cycles say about the sums of this one, with a gain that follows the motion.

Averaged sums ȳ ← ȳ + g (y - ȳ) hold less noise, and lag. How much averaging a touch bears is read from the innovations
y - ȳ alone, without knowing the sensor's noise:

* While the touch moves, ȳ lags, and each innovation resembles the one before. While it rests, each corrects the last
  and they differ. The gain rises and falls with the correlation of successive innovations over all sums, the test by
  which Mehra (1970) adapts a Kalman filter.
* A sudden change shows as an innovation larger than the noise seen in quiet times; then the gain goes to 1 at once.

A sum that does not come keeps what was known of it with a weight that fades as fast as the gain tells, so that nothing
of the past stays while the touch moves.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from reconstructor.kernels.recall import FLOOR, GAIN, WHITE, Recall, remember

Values = npt.NDArray[np.floating[Any]]


class Memory:
    """Averaged sums of one stream of measurements.

    Parameters
    ----------
    sums : int
        m.
    dtype : float32 or float64
    """

    def __init__(self, sums: int, dtype: npt.DTypeLike) -> None:
        kind = np.dtype(dtype)
        self._recall = Recall(np.zeros(sums, kind), np.zeros(sums, kind), np.zeros(sums, kind), np.zeros(3))
        self.reset()

    @property
    def sums(self) -> Values:
        """Averaged sums ȳ in newtons, shape (m,); a view."""
        return self._recall.sums

    @property
    def weights(self) -> Values:
        """How much each sum counts, 0 to 1, shape (m,); a view."""
        return self._recall.weights

    @property
    def gain(self) -> float:
        """The gain g of the last cycle, 0 to 1."""
        return float(self._recall.state[GAIN])

    @property
    def noise_ratio(self) -> float:
        """Standard deviation of ȳ over that of y, √(g / (2 - g))."""
        return float((self.gain / (2 - self.gain)) ** 0.5)

    @property
    def noise_n(self) -> float:
        """Standard deviation of the noise of one cycle's sums in the quietest of recent times, 0 while unknown."""
        return float(self._recall.state[FLOOR] ** 0.5)

    def take(self, sums_n: Values, valid: npt.NDArray[np.bool_]) -> bool:
        """Take in one cycle, arrays of shape (m,); False, and nothing changes, if a valid sum is not finite newtons."""
        return bool(remember(self._recall, sums_n, valid))

    def reset(self) -> None:
        """Forget every sum; the noise that was seen is kept, for the sensor is the same."""
        for each in (self._recall.sums, self._recall.weights, self._recall.innovation):
            each[:] = 0
        state = self._recall.state
        state[WHITE] = state[GAIN] = 1.0

    def restart(self) -> None:
        """Forget everything, as after construction."""
        self.reset()
        self._recall.state[FLOOR] = 0.0
