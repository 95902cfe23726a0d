"""The contourlet: a Laplacian pyramid, and a directional filter bank on its detail (Do and Vetterli 2005)."""

import numpy as np

from canskin.errors import InputError
from reconstructor.bases.directional import Level, bank
from reconstructor.bases.pkva import ROOT_TWO, fan, pyramid_pair
from reconstructor.checks import Values, check_values, is_whole

#: 2⁵ directions: the toolbox's nlevs = [5].
LEVELS = 5


class Contourlet:
    """Ψ of shape (n, 5n/4): x = Ψs; with D the coarse image's filters down, U up, and F the directional bank.

        analysis    c = D x Dᵀ,  s = (c, F(x - U c Uᵀ))
        synthesis   d = F⁻¹s_d,  x = d + U (c - D d Dᵀ) Uᵀ

    Coefficients are in the order of the toolbox's ``pdfbdec`` with nlevs = [5]: the low-pass image, then 16 bands of
    (rows / 16, columns / 2), then 16 of (rows / 2, columns / 16), each row by row. Ψ is neither tight nor orthogonal:
    `forward` is its transpose, as FISTA needs it, and `analyse` a left inverse, as images need it.

    Parameters
    ----------
    rows, columns : int
        Equal, a power of two, 16 to 256: the shears of the bank need a square.
    """

    def __init__(self, rows: int, columns: int) -> None:
        if rows != columns or not is_whole(rows) or rows & (rows - 1) or not 16 <= rows <= 256:
            raise InputError(f"a contourlet needs a square, a power of two, 16 to 256: got {rows} x {columns}")
        self.image_shape = (rows, columns)
        self.shape = (5 * rows * columns // 4,)
        self.levels, self.order = bank(rows, LEVELS)
        self.pair = pyramid_pair(rows)

    def analyse(self, image: Values) -> Values:
        """Return coefficients whose synthesis is `image`, shape (5n/4,): the toolbox's ``pdfbdec``."""
        check_values("image", image, self.image_shape)
        down, up = (side.astype(image.dtype) for side in self.pair)
        coarse = down @ image @ down.T
        work = (image - up @ coarse @ up.T).reshape(-1)
        for level in self.levels:
            first, second = _halves(work[level.gather], level)
            low = (first - fan(second, quincunx=level.quincunx, mirrored=True)) / image.dtype.type(ROOT_TWO)
            high = -image.dtype.type(ROOT_TWO) * second - fan(low, quincunx=level.quincunx, mirrored=False)
            work = np.concatenate((low.reshape(-1), high.reshape(-1)))
        return np.concatenate((coarse.reshape(-1), work[self.order]))

    def forward(self, image: Values) -> Values:
        """Return Ψᵀx, shape (5n/4,)."""
        check_values("image", image, self.image_shape)
        down, up = (side.astype(image.dtype) for side in self.pair)
        coarse = up.T @ image @ up
        work = (image - down.T @ coarse @ down).reshape(-1)
        for level in self.levels:
            first, second = _halves(work[level.gather], level)
            high = -(second + fan(first, quincunx=level.quincunx, mirrored=False)) / image.dtype.type(ROOT_TWO)
            low = image.dtype.type(ROOT_TWO) * first + fan(high, quincunx=level.quincunx, mirrored=True)
            work = np.concatenate((low.reshape(-1), high.reshape(-1)))
        return np.concatenate((coarse.reshape(-1), work[self.order]))

    def adjoint(self, coefficients: Values) -> Values:
        """Return x = Ψs, shape (rows, columns)."""
        check_values("coefficients", coefficients, self.shape)
        kind = coefficients.dtype.type
        coarse_size = self.order.size // 4
        coarse = coefficients[:coarse_size].reshape(self.image_shape[0] // 2, -1)
        work = np.empty_like(coefficients[coarse_size:])
        work[self.order] = coefficients[coarse_size:]
        for level in self.levels[::-1]:
            low, high = _halves(work, level)
            second = -(high + fan(low, quincunx=level.quincunx, mirrored=False)) / kind(ROOT_TWO)
            first = kind(ROOT_TWO) * low + fan(second, quincunx=level.quincunx, mirrored=True)
            work = np.empty_like(work)
            work[level.gather] = np.concatenate((first.reshape(-1), second.reshape(-1)))
        down, up = (side.astype(kind) for side in self.pair)
        detail = work.reshape(self.image_shape)
        return detail + up @ (coarse - down @ detail @ down.T) @ up.T


def _halves(work: Values, level: Level) -> tuple[Values, Values]:
    halves = work.reshape(2, level.bands, level.rows, level.columns)
    return halves[0], halves[1]
