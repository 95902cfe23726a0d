"""Tensor bases: a full one-dimensional transform of every row and of every column, S = T X Tᵀ (Table I)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from reconstructor.bases.basis import Values
from reconstructor.checks import check_grid, check_values

Matrix = npt.NDArray[np.float64]

#: Low-pass taps of D4 (Daubechies 1988): (1 + √3, 3 + √3, 3 - √3, 1 - √3) / (4 √2).
DAUBECHIES_4: Final = tuple(
    (whole + sign * 3**0.5) / (4 * 2**0.5) for whole, sign in ((1, 1), (3, 1), (3, -1), (1, -1))
)


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


def haar_tensor(rows: int, columns: int) -> Separable:
    """Return the tensor Haar basis: low[k] = (x[2k] + x[2k+1]) / √2, high[k] = (x[2k] - x[2k+1]) / √2, on all levels.

    Raises
    ------
    InputError
        If a side is not a power of two, 8 to 256; so do the other bases.
    """
    return _wavelet(rows, columns, haar_step)


def daubechies4_tensor(rows: int, columns: int) -> Separable:
    """Return the tensor D4 basis, periodic, down to length 2.

    low[k] = Σ h[i] x[2k+i] with h = (1+√3, 3+√3, 3-√3, 1-√3) / (4√2), and high[k] = Σ (-1)^i h[3-i] x[2k+i].
    """
    return _wavelet(rows, columns, daubechies4_step)


def haar_step(size: int) -> Matrix:
    """Return one Haar level, shape (size, size): averages above differences."""
    root_half = 0.5**0.5
    return _filter_step(size, (root_half, root_half), (root_half, -root_half))


def daubechies4_step(size: int) -> Matrix:
    """Return one D4 level, shape (size, size), orthonormal at every size from 2: the taps wrap round."""
    a, b, c, d = DAUBECHIES_4
    return _filter_step(size, DAUBECHIES_4, (d, -c, b, -a))


def _filter_step(size: int, low: tuple[float, ...], high: tuple[float, ...]) -> Matrix:
    step = np.zeros((size, size))
    for k in range(size // 2):
        for i, (one, other) in enumerate(zip(low, high, strict=True)):
            step[k, (2 * k + i) % size] += one
            step[size // 2 + k, (2 * k + i) % size] += other
    return step


def _wavelet(rows: int, columns: int, step: Callable[[int], Matrix]) -> Separable:
    check_grid(rows, columns)
    return Separable(_all_levels(rows, step), _all_levels(columns, step))


def _all_levels(size: int, step: Callable[[int], Matrix]) -> Matrix:
    """Apply `step` to the low half again and again until one value is left."""
    transform = np.eye(size)
    length = size
    while length > 1:
        transform[:length] = step(length) @ transform[:length]
        length //= 2
    return transform
