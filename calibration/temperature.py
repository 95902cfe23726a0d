"""What the temperature of the boards tells of the zero: offsets that follow it, by a coefficient that is learned.

The zero z of boards whose totals tell the mean of their taxels has moved by forces below zero, slowly, or by a person's
word while its temperature T changed. Of all boards together, with means over an hour taken off, κ = Σ T z / Σ T². Where
T explains most of z, the zero of each board rises by κ ΔT at once, less what it has risen already. A zero that falls
shows by itself.
"""

from typing import Final

import numpy as np

from calibration.windows import Floats

#: Readings over which means and κ are formed: an hour, of one in five seconds.
MEMORY: Final = 720
#: Least readings before κ counts (a minute), least deviation of the temperatures, and least part of the variance of the
#: zeros that the temperatures explain.
LEAST_READINGS: Final = 12
LEAST_CHANGE_K: Final = 0.5
LEAST_EXPLAINED: Final = 0.7


class TemperatureModel:
    """Learns how the zero follows the temperature.

    Attributes
    ----------
    newton_per_k : float
        κ of a taxel; 0 while nothing is known.
    """

    def __init__(self, blocks: int) -> None:
        self.newton_per_k = 0.0
        self._last_k, self._last_n = np.full((2, blocks), np.nan)
        self._mean_k, self._mean_n = np.zeros((2, blocks))
        self._count = np.zeros(blocks, np.intp)
        self._readings = 0
        #: Σ T², Σ T z, Σ z² over readings.
        self._squares = np.zeros(3)

    def restart(self) -> None:
        """Begin with zeros that have nothing to do with those before; κ stays."""
        self._last_n[:] = np.nan
        self._count[:] = 0

    def take(self, kelvin: Floats, zero_n: Floats) -> Floats:
        """Take readings; return by how much the zero of each board has yet to move since the last, newtons a taxel.

        Parameters
        ----------
        kelvin : array, shape (blocks,)
            NaN where unknown.
        zero_n : array, shape (blocks,)
            How far the zero of each board has moved by other evidence and by what was returned, mean of its taxels;
            NaN where no total tells.
        """
        told = np.isfinite(zero_n)
        zero_n = np.where(told, zero_n, zero_n[told].mean() if told.any() else 0.0)
        known = np.isfinite(kelvin)
        left_n = self.newton_per_k * (kelvin - self._last_k) - np.maximum(zero_n - self._last_n, 0)
        left_n = np.where(np.isfinite(left_n), np.maximum(left_n, 0), 0.0)
        zero_n = zero_n + left_n
        self._last_k, self._last_n = np.where(known, (kelvin, zero_n), (self._last_k, self._last_n))
        self._readings += 1
        known &= told
        self._count[known] += 1
        gain = known / np.clip(self._count, 1, MEMORY)
        off_k = np.where(known, kelvin - self._mean_k, 0.0)
        off_n = np.where(known, zero_n - self._mean_n, 0.0)
        self._mean_k += gain * off_k
        self._mean_n += gain * off_n
        old = self._count > 1
        pairs = np.array([(off_k**2)[old].sum(), (off_k * off_n)[old].sum(), (off_n**2)[old].sum()])
        self._squares += pairs - self._squares / MEMORY
        self._learn(int(known.sum()))
        return left_n

    def _learn(self, boards: int) -> None:
        temperatures, both, zeros = self._squares
        readings = max(1, boards) * min(MEMORY, self._readings)
        has_changed = self._readings >= LEAST_READINGS and temperatures > readings * LEAST_CHANGE_K**2
        explains = both**2 > LEAST_EXPLAINED * temperatures * zeros
        self.newton_per_k = float(both / temperatures) if has_changed and explains else 0.0
