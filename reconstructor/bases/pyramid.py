"""The wavelet pyramid (Mallat): each level transforms rows and columns of the low quadrant of the level before."""

import numpy as np
import pywt

from reconstructor.bases.separable import DAUBECHIES_4, HAAR, wavelet_step
from reconstructor.checks import Values, check_grid, check_values


class Pyramid:
    """[[LL, LH], [HL, HH]] = H X Hᵀ with one level H, then the same for LL, until its shorter side is 1.

    Parameters
    ----------
    rows, columns : int
        Powers of two, 8 to 256.
    wavelet : pywt.Wavelet
        Orthogonal; periodic, with the phase of `reconstructor.bases.separable.wavelet_tensor`.

    Attributes
    ----------
    steps : list of (array, array)
        H along the columns and along the rows, for each level.

    Raises
    ------
    InputError
        If a side is not.
    """

    def __init__(self, rows: int, columns: int, wavelet: pywt.Wavelet) -> None:
        check_grid(rows, columns)
        self.image_shape = self.shape = (rows, columns)
        self._sizes = [(rows >> level, columns >> level) for level in range(min(rows, columns).bit_length() - 1)]
        self.steps = [(wavelet_step(wavelet, height), wavelet_step(wavelet, width)) for height, width in self._sizes]

    @property
    def dtype(self) -> np.dtype[np.float64]:
        """float64: the entries are real numbers."""
        return np.dtype(np.float64)

    def forward(self, image: Values) -> Values:
        """Return the coefficients, shape (rows, columns), coarsest at the upper left."""
        check_values("image", image, self.image_shape)
        coefficients = image.copy()
        for (height, width), (down, across) in zip(self._sizes, self.steps, strict=True):
            coefficients[:height, :width] = down @ coefficients[:height, :width] @ across.T
        return coefficients

    def adjoint(self, coefficients: Values) -> Values:
        """Return the image."""
        check_values("coefficients", coefficients, self.shape)
        image: Values = np.array(coefficients)
        for (height, width), (down, across) in zip(self._sizes[::-1], self.steps[::-1], strict=True):
            image[:height, :width] = down.T @ image[:height, :width] @ across
        return image


def haar_pyramid(rows: int, columns: int) -> Pyramid:
    """Return the Haar pyramid.

    Raises
    ------
    InputError
        If a side is not a power of two, 8 to 256.
    """
    return Pyramid(rows, columns, HAAR)


def daubechies4_pyramid(rows: int, columns: int) -> Pyramid:
    """Return the D4 pyramid, periodic, with the phase of `daubechies4_tensor`.

    Raises
    ------
    InputError
        If a side is not a power of two, 8 to 256.
    """
    return Pyramid(rows, columns, DAUBECHIES_4)
