"""What the temperature of the boards tells of the zero, which follows it by a coefficient that is learned.

Of the boards whose totals tell the zero z of their taxels: κ = Σ T z / Σ T², with means over an hour taken off. A zero
that falls shows by itself, as forces below zero. A zero that rises looks like a touch: where T explains most of z, the
zero of each board rises by κ ΔT, less what has risen by other evidence.
"""

from typing import Final

import numpy as np

from calibration.windows import Floats

#: Readings over which means and κ are formed: an hour, of a reading in 5 s.
READINGS: Final = 720
#: κ counts when temperatures have changed by this deviation, and explain this part of the variance of the zeros.
LEAST_CHANGE_K: Final = 0.5
LEAST_EXPLAINED: Final = 0.7


class TemperatureModel:
    """Learns how the zero follows the temperature.

    Parameters
    ----------
    blocks : int

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
        #: Σ T², Σ T z, Σ z² over readings.
        self._squares = np.zeros(3)

    def take(self, kelvin: Floats, zero_n: Floats) -> Floats:
        """Take readings; return by how much the zero of each board has risen unseen since the last, newtons a taxel.

        Parameters
        ----------
        kelvin : array, shape (blocks,)
            NaN where unknown.
        zero_n : array, shape (blocks,)
            How far the zero of each board has moved, mean of its taxels; NaN where no total tells.
        """
        change_k, risen_n = kelvin - self._last_k, zero_n - self._last_n
        self._last_k = np.where(np.isfinite(kelvin), kelvin, self._last_k)
        self._last_n = np.where(np.isfinite(zero_n), zero_n, self._last_n)
        self._learn(kelvin, zero_n)
        told = np.isfinite(risen_n)
        risen_n = np.where(told, risen_n, risen_n[told].mean() if told.any() else 0.0)
        expected_n = self.newton_per_k * np.where(np.isfinite(change_k), change_k, 0.0)
        return np.maximum(expected_n - np.maximum(risen_n, 0), 0)

    def _learn(self, kelvin: Floats, zero_n: Floats) -> None:
        known = np.isfinite(kelvin) & np.isfinite(zero_n)
        self._count[known] += 1
        gain = known / np.clip(self._count, 1, READINGS)
        off_k, off_n = np.where(known, kelvin - self._mean_k, 0.0), np.where(known, zero_n - self._mean_n, 0.0)
        self._mean_k += gain * off_k
        self._mean_n += gain * off_n
        old = self._count > 1
        pairs = np.array([(off_k**2)[old].sum(), (off_k * off_n)[old].sum(), (off_n**2)[old].sum()])
        self._squares += pairs - self._squares / READINGS
        temperatures, both, zeros = self._squares
        readings = int(known.sum()) * min(READINGS, int(self._count.max()))
        has_changed = readings > 0 and temperatures > readings * LEAST_CHANGE_K**2
        explains = both**2 > LEAST_EXPLAINED * temperatures * zeros
        self.newton_per_k = float(both / temperatures) if has_changed and explains else 0.0
