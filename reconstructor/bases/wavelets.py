"""Bases of orthogonal wavelets: Mallat's pyramid, and the tensor of the paper's tables."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from reconstructor.bases.names import wavelet_of
from reconstructor.checks import Values, check_grid, check_values

if TYPE_CHECKING:
    import pywt

Matrix = npt.NDArray[np.floating[Any]]


class WaveletBasis:
    """X ↦ H X Kᵀ with orthonormal matrices H and K of each step, of the upper left corner that a step takes.

    Parameters
    ----------
    steps : list of (array, array)
        H along the columns and K along the rows, square; those of the first step have the size of the image.
    """

    def __init__(self, steps: list[tuple[Matrix, Matrix]]) -> None:
        self.steps = steps
        self.image_shape = self.shape = len(steps[0][0]), len(steps[0][1])

    def forward(self, image: Values) -> Values:
        """Return the coefficients, shape (rows, columns), the coarsest at the upper left."""
        check_values("image", image, self.image_shape)
        coefficients: npt.NDArray[Any] = image.copy()
        for down, across in self.steps:
            corner = coefficients[: len(down), : len(across)]
            corner[:] = down @ corner @ across.T
        return coefficients

    def adjoint(self, coefficients: Values) -> Values:
        """Return the image."""
        check_values("coefficients", coefficients, self.shape)
        image: npt.NDArray[Any] = coefficients.copy()
        for down, across in reversed(self.steps):
            corner = image[: len(down), : len(across)]
            corner[:] = down.T @ corner @ across
        return image


def wavelet_basis(name: str, rows: int, columns: int, dtype: npt.DTypeLike = np.float64) -> WaveletBasis:
    """Return the basis of an orthogonal wavelet, periodic, on sides of 8 to 256; `name` as for `wavelet_basis_name`.

    A level is low[k] = Σ h[i] x[2k+i] and high[k] = Σ g[i] x[2k+i] with the wavelet's h = ``rec_lo`` and g =
    ``rec_hi``. "pyramid": each level transforms rows and columns of the low quadrant of the level before, until its
    shorter side is 1. "tensor": all levels of each column, then all of each row, down to length 1 (Table I). `dtype` is
    that of the matrices.
    """
    wavelet, form = wavelet_of(name)
    check_grid(rows, columns)
    if form == "tensor":
        steps = [(_all_levels(rows, wavelet), _all_levels(columns, wavelet))]
    else:
        sizes = [(rows >> level, columns >> level) for level in range(min(rows, columns).bit_length() - 1)]
        steps = [(wavelet_step(wavelet, height), wavelet_step(wavelet, width)) for height, width in sizes]
    return WaveletBasis([(down.astype(dtype), across.astype(dtype)) for down, across in steps])


def wavelet_step(wavelet: "pywt.Wavelet", size: int) -> Matrix:
    """Return one level of an orthogonal wavelet, shape (size, size), low half above high half, periodic.

    PyWavelets' periodic transform starts half a filter before sample 2k; the phase here is that of `wavelet_basis`.
    """
    import pywt

    first = np.roll(np.eye(size), 1 - wavelet.dec_len // 2, axis=0)
    return np.concatenate(pywt.dwt(first, wavelet, "periodization", axis=0))


def _all_levels(size: int, wavelet: "pywt.Wavelet") -> Matrix:
    """Apply levels to the low half until one value is left."""
    transform = np.eye(size)
    length = size
    while length > 1:
        transform[:length] = wavelet_step(wavelet, length) @ transform[:length]
        length //= 2
    return transform
