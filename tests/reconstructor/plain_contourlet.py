"""The contourlet in plain NumPy: the reference of the compiled contourlet."""

from typing import Any

import numpy as np
import numpy.typing as npt

from reconstructor.bases.contourlet import Contourlet
from reconstructor.bases.directional import Level
from reconstructor.bases.pkva import FAN, ROOT_TWO
from reconstructor.checks import Values


class PlainContourlet(Contourlet):
    """`Contourlet` with its analysis, and `forward` and `adjoint` of any dtype."""

    def analyse(self, image: Values) -> Values:
        """Return coefficients whose synthesis is `image`, shape (5n/4,): the toolbox's ``pdfbdec``."""
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


def fan(images: Values, *, quincunx: bool, mirrored: bool) -> Values:
    """Filter the last two axes, (..., rows, columns), with FAN along both, periodically.

    Parameters
    ----------
    quincunx : bool
        Samples that leave at the top or bottom enter shifted by half the width.
    mirrored : bool
        With the filter turned by 180°: the adjoint.
    """
    before = 6 if mirrored else 5
    rows, columns = images.shape[-2:]
    across: npt.NDArray[Any] = sum(
        tap * np.roll(images, before - t, axis=-1) for t, tap in enumerate(FAN[::-1].astype(images.dtype))
    )
    place = np.arange(rows)[:, None] + np.arange(12)[None, :] - before
    made = np.zeros_like(images)
    for t, tap in enumerate(FAN[::-1].astype(images.dtype)):
        wraps, row = np.divmod(place[:, t], rows)
        taken = across[..., row, :]
        if quincunx:
            odd = wraps % 2 == 1
            taken[..., odd, :] = np.roll(taken[..., odd, :], columns // 2, axis=-1)
        made += tap * taken
    return made
