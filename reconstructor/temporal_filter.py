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

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from reconstructor.checks import LARGEST_N, Values
from reconstructor.kernels.transforms import Flat
from shell.compiled import njit

#: Smallest gain.
GAIN_MIN: Final = 0.18
#: Noise alone gives successive innovations a correlation of -g / 2. The gain rises while the correlation is above
#: -CORRELATION_RATIO · g / 2, else it falls. A ratio of 0 would allow more lag; lag is worse than noise, which the
#: prior removes.
CORRELATION_RATIO: Final = 0.6
#: Innovations with an energy of up to BAND x the energy of the noise are no sudden change.
BAND: Final = 1.15
#: At a sudden change the gain is 1 - ε^STEEPNESS, ε = energy of the noise / energy of the innovation.
STEEPNESS: Final = 4
#: The noise floor follows the noise power of quiet cycles. A cycle of less noise lowers the floor by FLOOR_FALL of the
#: difference, and never leaves it above FLOOR_MAX_RATIO times that cycle's noise power. Any other cycle raises the
#: floor by a factor of 1 + FLOOR_RISE.
FLOOR_FALL: Final = 0.2
FLOOR_MAX_RATIO: Final = 1.5
FLOOR_RISE: Final = 0.002
#: A missing sum is dropped when its weight is below this.
LEAST_WEIGHT: Final = 0.01
#: Places of `FilterState.state`: the gain by the correlation alone, the noise floor (N², 0: unknown), the last gain,
#: and the last innovation's energy over that of noise.
CORRELATION_GAIN, FLOOR, GAIN, SURPRISE = 0, 1, 2, 3


class FilterState(NamedTuple):
    """State of one stream of measurements.

    Attributes
    ----------
    sums, weights, innovation : shape (m,)
        Averaged sums in newtons, their weights (0 to 1), and the last innovations in newtons.
    state : float64, shape (4,)
    """

    sums: Flat
    weights: Flat
    innovation: Flat
    state: npt.NDArray[np.float64]


@njit(cache=True, nogil=True)
def update(filtered: FilterState, sums: Flat, valid: npt.NDArray[np.bool_], averages: bool) -> bool:
    """Process one cycle; return False, without a change, if a valid sum is not finite or above `LARGEST_N`.

    Without `averages` sums are taken as they come: only the noise floor and the weights of missing sums are followed.
    """
    energy, before, product, count = 0.0, 0.0, 0.0, 0
    for k in range(sums.size):
        if valid[k]:
            if not abs(sums[k]) <= LARGEST_N:  # NaN fails this form of the test
                return False
            if filtered.weights[k] > 0:
                innovation = float(sums[k] - filtered.sums[k])
                energy += innovation * innovation
                product += innovation * filtered.innovation[k]
                before += filtered.innovation[k] * filtered.innovation[k]
                count += 1
    fading = 1.0
    if count > 0:
        if not averages:
            filtered.state[CORRELATION_GAIN] = GAIN_MIN  # noise that was averaged before is correlated as motion is
        correlation = product / max(np.sqrt(energy * before), 1e-30) if averages else -1.0
        fading = _adapt(filtered.state, energy / count, correlation)
    gain = fading if averages else 1.0
    filtered.state[GAIN] = gain
    for k in range(sums.size):
        if valid[k]:
            innovation = float(sums[k] - filtered.sums[k])
            filtered.sums[k] += max(gain, 1.0 - filtered.weights[k]) * innovation
            filtered.innovation[k] = innovation if filtered.weights[k] > 0 else 0.0
            filtered.weights[k] = 1.0
        else:
            left = filtered.weights[k] * (1.0 - fading)
            filtered.weights[k] = left if left > LEAST_WEIGHT else 0.0
            filtered.innovation[k] = 0.0
    return True


@njit(cache=True, nogil=True)
def _adapt(state: npt.NDArray[np.float64], energy: float, correlation: float) -> float:
    """Return the gain for an innovation of mean square `energy` and its correlation with the innovation before."""
    last = state[GAIN]
    factor = np.exp(correlation + CORRELATION_RATIO * last / 2.0)
    state[CORRELATION_GAIN] = min(1.0, max(GAIN_MIN, state[CORRELATION_GAIN] * factor))
    noise = energy * (2.0 - last) / 2.0  # of one cycle's sums; averaged sums have g / (2 - g) of their noise
    if state[FLOOR] == 0.0:
        state[FLOOR] = noise
    state[SURPRISE] = noise / state[FLOOR] if state[FLOOR] > 0 else 1.0
    explained = BAND * state[FLOOR] * 2.0 / (2.0 - last)
    gain = float(state[CORRELATION_GAIN])
    if energy > explained:
        gain = max(gain, 1.0 - (explained / energy) ** STEEPNESS)
    if noise < state[FLOOR]:
        state[FLOOR] = min(state[FLOOR] + FLOOR_FALL * (noise - state[FLOOR]), FLOOR_MAX_RATIO * noise)
    else:
        state[FLOOR] *= 1.0 + FLOOR_RISE
    return gain


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

    def expect(self, sums_n: Values) -> None:
        """Put in place of the sums before, shape (m,), what they would be with another Φ."""
        self._filtered.sums[:] = sums_n

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
