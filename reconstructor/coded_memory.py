"""The image before as the memory of a solver whose Φ changes from frame to frame."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from reconstructor.checks import Values
from reconstructor.kernels.transforms import Flat
from shell.compiled import njit
from skin.matrix import MatrixPhi

#: Least part of the iterations, and how fast the part follows: of 0.25 to 2 the best on the sums of a single-wire skin
#: (`skin evaluate single-wire`), where a part of 1 doubles the error of 7 sums.
LEAST_PART: Final = 0.1
RATE: Final = 0.25
#: An image before whose sums are off by this part of the energy of the sums is of another touch: no image is as good.
OTHER_TOUCH: Final = 1.0


class CodedMemory:
    """Predicts the sums of the next frame, and tells how far to leave the image before.

    Few sums of one frame fit many images. An image that fits their noise, too, is worse than the image before, so not
    all iterations are made, but a part of them. The part follows the innovations e = y - Φx, x the image before. Where
    e goes along with d = Φ(x - x'), x' the image before that, the last change was too small, and the part grows;
    where e goes against d, the last change was noise, and the part falls: part ← part · exp(RATE cos(e, d)). The
    cosine leaves out what total force makes of sums, which 0/1 codes feel first.

    Parameters
    ----------
    taxels, sums : int
        n and m.

    Attributes
    ----------
    part : float
        `LEAST_PART` to 1.
    """

    def __init__(self, taxels: int, sums: int, dtype: npt.DTypeLike) -> None:
        self._before = np.zeros(taxels, dtype)
        self._told = np.zeros((3, sums), dtype)
        self.part = 1.0

    def expect(self, estimate: Values, phi: MatrixPhi) -> Values:
        """Return the sums Φx of the image before, shape (m,), with the Φ of this frame; a view."""
        tell(phi.dense, estimate, self._before, self._told)
        expected: Values = self._told[0]
        return expected

    def follow(self, estimate: Values, sums_n: Values, valid: npt.NDArray[np.bool_]) -> float:
        """Take the sums that came in place of the expected, shape (m,), and return the part of the iterations."""
        cosine, is_other = compare(self._told, sums_n, valid)
        self._before[:] = estimate
        self.part = 1.0 if is_other else min(1.0, max(LEAST_PART, self.part * float(np.exp(RATE * cosine))))
        return self.part

    def reset(self) -> None:
        """Forget the images before."""
        self._before[:] = 0
        self.part = 1.0


@njit(cache=True, nogil=True)
def tell(matrix: Any, estimate: Flat, before: Flat, told: Any) -> None:
    """Write Φx, Φ(x - x') and Φ1 into `told`, shape (3, m)."""
    told[0] = np.dot(matrix, estimate)
    told[1] = told[0] - np.dot(matrix, before)
    for k in range(matrix.shape[0]):
        told[2, k] = matrix[k].sum()


@njit(cache=True, nogil=True)
def compare(told: Any, sums: Flat, valid: npt.NDArray[np.bool_]) -> tuple[float, bool]:
    """Return cos(e, d) across total force, and whether e has `OTHER_TOUCH` of the energy of y, or more.

    With t = Φ1, the product across it of any two vectors of sums is a·b - (a·t)(b·t) / t·t.
    """
    ee, dd, ed, et, dt, tt, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(sums.size):
        if valid[k]:
            y, d, t = float(sums[k]), float(told[1, k]), float(told[2, k])
            e = y - told[0, k]
            ee, dd, ed, yy = ee + e * e, dd + d * d, ed + e * d, yy + y * y
            et, dt, tt = et + e * t, dt + d * t, tt + t * t
    is_other = ee >= OTHER_TOUCH * yy
    if tt > 0:
        ee, dd, ed = ee - et * et / tt, dd - dt * dt / tt, ed - et * dt / tt
    cosine = ed / np.sqrt(ee * dd) if ee > 0 and dd > 0 else 0.0
    return min(1.0, max(-1.0, cosine)), is_other
