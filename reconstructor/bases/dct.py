"""The orthonormal two-dimensional cosine transform (DCT-II)."""

from typing import Any

import numpy.typing as npt
from scipy import fft

from reconstructor.checks import Values, check_grid, check_values


class Dct:
    """S[u, v] = c_u c_v Σ x[i, j] cos(π(2i+1)u / 2R) cos(π(2j+1)v / 2C), c_0 = √(1/N), else √(2/N).

    Parameters
    ----------
    rows, columns : int
        Powers of two, 8 to 256.
    """

    def __init__(self, rows: int, columns: int) -> None:
        check_grid(rows, columns)
        self.image_shape = self.shape = (rows, columns)

    def forward(self, image: Values) -> Values:
        """Return the coefficients, shape (rows, columns)."""
        check_values("image", image, self.image_shape)
        coefficients: npt.NDArray[Any] = fft.dctn(image, norm="ortho")
        return coefficients

    def adjoint(self, coefficients: Values) -> Values:
        """Return the image."""
        check_values("coefficients", coefficients, self.shape)
        image: npt.NDArray[Any] = fft.idctn(coefficients, norm="ortho")
        return image
