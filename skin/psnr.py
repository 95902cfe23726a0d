"""Peak signal-to-noise ratio: how close an image is to the true force."""

import math

import numpy as np
import numpy.typing as npt


def decibels(mean_square_n2: npt.ArrayLike, peak_n: float) -> npt.NDArray[np.float64]:
    """Return the PSNR of mean squared errors (the paper's equation of f_PSNR).

    Parameters
    ----------
    mean_square_n2 : array_like
        Mean over an image of the squared error, newtons squared; of any shape.
    peak_n : float
        Largest force a taxel can feel, µ.

    Returns
    -------
    array of float64, the same shape
        Decibels; no error gives 200.
    """
    floored = np.maximum(mean_square_n2, peak_n**2 * 1e-20)
    return np.asarray(10 * np.log10(peak_n**2 / floored), np.float64)


def psnr_db(true: npt.NDArray[np.floating], other: npt.NDArray[np.floating], peak_n: float) -> float:
    """Return the peak signal-to-noise ratio of `other` against `true`, see `decibels`.

    Parameters
    ----------
    true, other : arrays of float, shape (rows, columns)
        Newtons.
    peak_n : float
        Largest force a taxel can feel, µ.

    Returns
    -------
    float
        Decibels; equal images give 200.
    """
    return float(decibels(np.mean((true.astype(np.float64) - other) ** 2), peak_n))


def adds_noise(sensor_db: float, adc_bits: int) -> bool:
    """Tell whether a sensor of this PSNR does more than round to its ADC's steps: half a step everywhere or less."""
    return sensor_db < 20 * math.log10(2 * ((1 << adc_bits) - 1))
