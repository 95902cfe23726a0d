"""Tensor bases: a full one-dimensional transform of every row and of every column, S = T X Tᵀ (Table I)."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pywt

from reconstructor.checks import Values, check_grid, check_values

Matrix = npt.NDArray[np.float64]

#: The wavelets of the paper, from PyWavelets. D4 has four taps (Daubechies 1988), which PyWavelets calls db2.
HAAR: Final = pywt.Wavelet("haar")
DAUBECHIES_4: Final = pywt.Wavelet("db2")


@dataclass(frozen=True, eq=False)
class Separable:
    """S = T_rows X T_columnsᵀ with orthonormal matrices T.

    Attributes
    ----------
    rows_matrix, columns_matrix : array, shape (rows, rows) and (columns, columns)
        Applied along the columns of the image and along its rows.
    """

    rows_matrix: Matrix
    columns_matrix: Matrix

    @property
    def image_shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return len(self.rows_matrix), len(self.columns_matrix)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.image_shape

    @property
    def steps(self) -> list[tuple[Matrix, Matrix]]:
        """The matrices of both directions: like a pyramid of one level."""
        return [(self.rows_matrix, self.columns_matrix)]

    @property
    def dtype(self) -> np.dtype[np.float64]:
        """float64: the entries are real numbers."""
        return np.dtype(np.float64)

    def forward(self, image: Values) -> Values:
        """Return T_rows X T_columnsᵀ."""
        check_values("image", image, self.image_shape)
        result: npt.NDArray[Any] = self.rows_matrix @ image @ self.columns_matrix.T
        return result.astype(image.dtype, copy=False)

    def adjoint(self, coefficients: Values) -> Values:
        """Return T_rowsᵀ S T_columns."""
        check_values("coefficients", coefficients, self.shape)
        result: npt.NDArray[Any] = self.rows_matrix.T @ coefficients @ self.columns_matrix
        return result.astype(coefficients.dtype, copy=False)


def wavelet_tensor(wavelet: pywt.Wavelet, rows: int, columns: int) -> Separable:
    """Return the tensor basis of an orthogonal wavelet, periodic, down to length 1.

    low[k] = Σ h[i] x[2k+i] and high[k] = Σ g[i] x[2k+i] with the wavelet's h = ``rec_lo`` and g = ``rec_hi``.

    Raises
    ------
    InputError
        If a side is not a power of two, 8 to 256; so do the other bases.
    """
    check_grid(rows, columns)
    return Separable(_all_levels(rows, wavelet), _all_levels(columns, wavelet))


def haar_tensor(rows: int, columns: int) -> Separable:
    """Return the tensor Haar basis: low[k] = (x[2k] + x[2k+1]) / √2, high[k] = (x[2k] - x[2k+1]) / √2."""
    return wavelet_tensor(HAAR, rows, columns)


def daubechies4_tensor(rows: int, columns: int) -> Separable:
    """Return the tensor D4 basis: h = (1+√3, 3+√3, 3-√3, 1-√3) / (4√2), g[i] = (-1)^i h[3-i]."""
    return wavelet_tensor(DAUBECHIES_4, rows, columns)


def wavelet_step(wavelet: pywt.Wavelet, size: int) -> Matrix:
    """Return one level of an orthogonal wavelet, shape (size, size), low half above high half, periodic.

    PyWavelets' periodic transform starts half a filter before sample 2k; the phase here is that of `wavelet_tensor`.
    """
    first = np.roll(np.eye(size), 1 - wavelet.dec_len // 2, axis=0)
    return np.concatenate(pywt.dwt(first, wavelet, "periodization", axis=0))


def _all_levels(size: int, wavelet: pywt.Wavelet) -> Matrix:
    """Apply levels to the low half until one value is left."""
    transform = np.eye(size)
    length = size
    while length > 1:
        transform[:length] = wavelet_step(wavelet, length) @ transform[:length]
        length //= 2
    return transform
