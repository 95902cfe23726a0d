"""The quality of tactile images, as the paper measures it (section V)."""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from skin.psnr import psnr_db as psnr_with_peak_db
from skin.taxel import FORCE_MAX_N


def psnr_db(true_n: npt.NDArray[np.floating], image_n: npt.NDArray[np.floating]) -> float:
    """Return the PSNR of an image, dB, with the peak at the sensor's largest force; equal images give 200."""
    return psnr_with_peak_db(true_n, image_n, FORCE_MAX_N)


def psnr_series_db(
    true_n: npt.NDArray[np.floating], images_n: Iterable[npt.NDArray[np.floating]]
) -> npt.NDArray[np.float64]:
    """Return the PSNR of every image of a series, dB, shape (frames,).

    Parameters
    ----------
    true_n : array of float, shape (frames, rows, columns)
        Newtons.
    images_n : iterable of such images
        As many.
    """
    return np.array([psnr_db(true, image) for true, image in zip(true_n, images_n, strict=True)])
