"""Which taxels something touches, from sums alone: offsets differ from taxel to taxel, a touch is the same around.

Φᵀ y / block size is a picture of the sums y. The part of a taxel's own force in it is (sums / taxels); what the other
taxels of its block add has no pattern on the skin. Offsets have none either. So the mean over a square of w x w taxels
has a deviation of σ / w without a touch, σ that of the picture, and every square that stands out is touched.
"""

from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter

from calibration.windows import Bools, Floats
from skin.measurement import Sbhe

#: Widths of the squares, taxels.
WIDTHS: Final = (3, 5, 9, 17)
#: A square stands out when its mean is more than so many deviations from 0. Of 10^4 pictures of noise alone none has
#: a square above 6.
LIMIT: Final = 7.0
#: Taxels this far from a touched square count as touched, too.
MARGIN: Final = 2
#: Standard deviation of normal numbers over the median of their sizes.
DEVIATION_OF_MEDIAN: Final = 1.4826


class Touch(NamedTuple):
    """Where something touches.

    Attributes
    ----------
    score : float
        Largest mean of a square, in its deviations.
    release_score : float
        The same of the negative means: forces below zero, so the zero is wrong.
    blocks : array of bool, shape (blocks,)
        Blocks with a taxel that is touched or near.
    row, column : int
        Centre of the square that stands out most.
    """

    score: float
    release_score: float
    blocks: Bools
    row: int
    column: int

    @property
    def is_touched(self) -> bool:
        """Whether anything touches."""
        return self.score > LIMIT and self.score >= self.release_score

    @property
    def is_negative(self) -> bool:
        """Whether forces below zero stand out most."""
        return self.release_score > LIMIT and not self.is_touched


class TouchFinder:
    """Finds touched taxels.

    Parameters
    ----------
    phi : Sbhe
    rows, columns : int
    """

    def __init__(self, phi: Sbhe, rows: int, columns: int) -> None:
        self._phi = phi
        self._shape = rows, columns
        self._totals = phi.row_of_sum == 0
        self._gain = float(np.sqrt(phi.shape[0] / phi.blocks)) / phi.block_size

    def look(self, sums_n: Floats, known: Bools, noise_n: float) -> Touch:
        """Find what touches.

        Parameters
        ----------
        sums_n : array, shape (m,)
            Sums less their offsets, newtons.
        known : array of bool, shape (m,)
            Other sums have no part in it.
        noise_n : float
            Standard deviation of `sums_n` by noise alone; they may differ more, by offsets.
        """
        picture = self._picture(sums_n, known)
        deviation = max(DEVIATION_OF_MEDIAN * float(np.median(np.abs(picture))), noise_n * self._gain, 1e-12)
        touched = np.zeros(self._shape, np.bool_)
        score = release = 0.0
        place = 0
        for width in WIDTHS:
            if width > min(self._shape):
                break
            means = uniform_filter(picture, width, mode="constant") * (width / deviation)
            outside = means > LIMIT
            if outside.any():
                touched |= binary_dilation(outside, iterations=width // 2 + MARGIN)
            if means.max() > score:
                score, place = float(means.max()), int(means.argmax())
            release = max(release, -float(means.min()))
        blocks = np.zeros(self._phi.blocks, np.bool_)
        blocks[self._phi.block_of_taxel[touched.ravel()]] = True
        return Touch(score, release, blocks, place // self._shape[1], place % self._shape[1])

    def _picture(self, sums_n: Floats, known: Bools) -> Floats:
        used = np.where(known, sums_n, 0.0)
        totals = self._totals & known
        if totals.any():  # an offset that all taxels have in common is no touch
            used[totals] -= np.median(sums_n[totals])
        picture: Floats = np.asarray(self._phi.adjoint(used), np.float64).reshape(self._shape)
        return picture / self._phi.block_size
