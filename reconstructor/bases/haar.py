"""The Haar pyramid (Mallat): rows and columns are halved together, and only the low quadrant goes on."""

import numpy as np

from reconstructor.bases.basis import Values, check_grid
from reconstructor.bases.separable import haar_step


class HaarPyramid:
    """[[LL, LH], [HL, HH]] = H X Hᵀ with one Haar level H, then the same for LL, until its shorter side is 1.

    Parameters
    ----------
    rows, columns : int
        Powers of two, 8 to 256.

    Raises
    ------
    InputError
        If a side is not.
    """

    def __init__(self, rows: int, columns: int) -> None:
        check_grid(rows, columns)
        self.image_shape = self.shape = (rows, columns)
        self._sizes = [(rows >> level, columns >> level) for level in range(min(rows, columns).bit_length() - 1)]
        self._steps = [(haar_step(height), haar_step(width)) for height, width in self._sizes]

    def forward(self, image: Values) -> Values:
        """Return the coefficients, shape (rows, columns), coarsest at the upper left."""
        coefficients = image.copy()
        for (height, width), (down, across) in zip(self._sizes, self._steps, strict=True):
            coefficients[:height, :width] = down @ coefficients[:height, :width] @ across.T
        return coefficients

    def adjoint(self, coefficients: Values) -> Values:
        """Return the image."""
        image: Values = np.array(coefficients)
        for (height, width), (down, across) in zip(self._sizes[::-1], self._steps[::-1], strict=True):
            image[:height, :width] = down.T @ image[:height, :width] @ across
        return image
