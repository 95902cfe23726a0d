"""The bias of a sensor that clips its noise at zero, and its correction.

An untouched taxel with noise N(0, σ²) reads max(0, noise), with mean σ / √(2π); averaging over time does not remove
this bias. A taxel under force x reads m(x) = x Φ(x / σ) + σ φ(x / σ) on average. With known σ, m⁻¹ removes the bias.
The correction is for images with averaged noise; on a single noisy image it acts like a dead zone below σ / √(2π).
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError

#: Mean and standard deviation of noise N(0, 1) that is clipped at 0.
IDLE_MEAN: Final = 1 / math.sqrt(2 * math.pi)
IDLE_DEVIATION: Final = math.sqrt(1 / 2 - 1 / (2 * math.pi))
#: Stepped nodes show a force below this part of its noise as 0.
DEAD_RATIO: Final = 0.4
#: Above this many σ the bias is below 1e-9 σ.
REACH: Final = 6.0
_POINTS: Final = 1025


def clipped_mean(force: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return m(x), the mean of x + N(0, 1) clipped at 0, for forces x in units of σ."""
    below = np.vectorize(math.erfc, otypes=[np.float64])(force * -math.sqrt(1 / 2)) / 2  # no service waits for SciPy's
    mean: npt.NDArray[np.float64] = force * below + np.exp(-(force**2) / 2) * IDLE_MEAN
    return mean


class ClipCorrection:
    """x = m⁻¹(image), 0 below m(0).

    Parameters
    ----------
    noise_n : float
        σ in newtons, above 0.
    """

    def __init__(self, noise_n: float) -> None:
        if not (noise_n > 0 and math.isfinite(noise_n)):
            raise InputError(f"the sensor's noise needs a number of newtons above 0: got {noise_n}")
        force = np.linspace(0, REACH, _POINTS)
        self._force = force * noise_n
        self._mean = clipped_mean(force) * noise_n

    def __call__(self, image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the corrected image, newtons."""
        made = np.where(image < self._mean[-1], np.interp(image, self._mean, self._force), image)
        return made.astype(np.float32)
