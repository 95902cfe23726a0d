"""Features of one measurement for a model, and the standardised peak that tells contact."""

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from classifier.features import Smoothed
from skin.phi import Phi
from skin.surface import Surface

#: Lower bound of a peak / its mean on the untouched skin.
_LEAST_PEAK: Final = 0.05


class Observer:
    """Computes the features of measurements; arrays are reused.

    Parameters
    ----------
    no_touch : array, shape (4, widths)
        See `classifier.model`.
    means : bool
        See `classifier.features.Smoothed`.
    """

    def __init__(self, phi: Phi, surface: Surface, no_touch: npt.NDArray[np.float64], *, means: bool = False) -> None:
        self.smoothed = Smoothed(phi, surface, means=means)
        self._energy_mean, self._energy_sd, self._peak_mean, self._peak_sd = no_touch.copy()
        widths = self._peak_mean.size
        self._standard = np.zeros(widths)
        #: Features of the newest `look`: asinh of the standardised energies, log of the relative peaks.
        self.features = np.zeros(2 * widths)

    def look(
        self,
        sums: npt.NDArray[Any],
        valid: npt.NDArray[np.float32],
        valid_ratio: float,
        noise_ratio: float = 1.0,
        cycle: int = 1,
    ) -> float:
        """Fill `features` and return the largest standardised peak.

        Missing blocks reduce the energy of the image; the features are corrected for this.

        Parameters
        ----------
        noise_ratio : float
            Noise of the sums / noise of the sums that `no_touch` is of. The peaks of an untouched skin grow with this
            ratio, its energy with the square.
        cycle : int
            See `classifier.features.Smoothed.measure`.
        """
        smoothed, standard, half = self.smoothed, self._standard, self._standard.size
        smoothed.measure(sums, valid, valid_ratio, cycle)
        np.multiply(self._energy_mean, -(noise_ratio**2), out=standard)
        standard += smoothed.energies
        standard /= self._energy_sd
        standard /= valid_ratio
        np.arcsinh(standard, out=self.features[:half])
        np.divide(smoothed.peaks, self._peak_mean, out=standard)
        standard /= math.sqrt(valid_ratio)
        np.maximum(standard, _LEAST_PEAK, out=standard)
        np.log(standard, out=self.features[half:])
        np.divide(smoothed.peaks, noise_ratio, out=standard)
        standard -= self._peak_mean
        standard /= self._peak_sd
        return float(standard.max())
