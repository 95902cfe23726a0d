"""Peak signal-to-noise ratio (PSNR) of an image against the true forces."""

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from skin.taxel import FORCE_MAX_N


def decibels(mean_square_n2: npt.ArrayLike, peak_n: float) -> npt.NDArray[np.float64]:
    """Return the PSNR of mean squared errors (the paper's equation of f_PSNR).

    Parameters
    ----------
    mean_square_n2 : array_like
        Mean squared error of each image, newtons squared; any shape.
    peak_n : float
        End of the taxels' range, µ.

    Returns
    -------
    array of float64, the same shape
        Decibels; an error of 0 gives 200.
    """
    floored = np.maximum(mean_square_n2, peak_n**2 * 1e-20)
    return np.asarray(10 * np.log10(peak_n**2 / floored), np.float64)


def psnr_db(true: npt.NDArray[np.floating], other: npt.NDArray[np.floating], peak_n: float = FORCE_MAX_N) -> float:
    """Return the peak signal-to-noise ratio of `other` against `true`, see `decibels`.

    Parameters
    ----------
    true, other : arrays of float, shape (rows, columns)
        Newtons.
    peak_n : float
        End of the taxels' range, µ.

    Returns
    -------
    float
        Decibels; equal images give 200.
    """
    return float(decibels(np.mean((true.astype(np.float64) - other) ** 2), peak_n))


def psnr_series_db(
    true: npt.NDArray[np.floating], others: Iterable[npt.NDArray[np.floating]]
) -> npt.NDArray[np.float64]:
    """Return `psnr_db` of every image of a series, shape (frames,); `true` has shape (frames, rows, columns)."""
    return np.array([psnr_db(one, other) for one, other in zip(true, others, strict=True)])


def adds_noise(sensor_db: float, adc_bits: int) -> bool:
    """Tell whether a sensor's error is larger than that of its ADC, half a step in every taxel."""
    return sensor_db < 20 * math.log10(2 * ((1 << adc_bits) - 1))
