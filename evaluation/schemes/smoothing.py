"""What a receiver can make of a baseline's values: our own live reconstruction, and arrays made finer."""

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import zoom

from evaluation.schemes.judge import Images
from evaluation.schemes.scenes import SIDE
from evaluation.schemes.sums import SOLVED_NS
from reconstructor.engine import Reconstructor
from reconstructor.settings import LIVE
from skin.measurement import Sbhe, sbhe
from touch.contact import Force

#: λ for complete arrays in newtons, with the best mean PSNR over the slides: of 6 to 36 mN, of 3 to 24 and of 12 to 48.
SCAN_PENALTY_N: Final = 0.018
CELLS_PENALTY_N: Final = 0.012
EVENTS_PENALTY_N: Final = 0.024


@cache
def _complete(cells: int) -> Sbhe:
    """Return a Φ that keeps every row of every block: an orthogonal transform, no compression."""
    return sbhe(cells, cells)


def smoothed(held: Images, penalty_n: float, *, temporal_filter: bool = True) -> Images:
    """Return what the live reconstruction makes of complete images, as if every sum of every block had come.

    The array is a square of 8 x 8 cells or more. The temporal filter is for images whose values are new each time.
    """
    cells = held.force_n.shape[1]
    side, phi = round(cells**0.5), _complete(cells)
    engine = Reconstructor(phi, side, side, replace(LIVE, penalty_n=penalty_n, temporal_filter=temporal_filter))
    valid = np.ones(cells, np.bool_)
    sums = np.asarray(phi.forward(held.force_n), np.float32)
    images = np.stack([engine.solve(each, valid).ravel() for each in sums])
    return Images(held.ready_ns + SOLVED_NS, images)


def refined(held: Images, order: int) -> Images:
    """Return a coarse array's images as fine as the skin, not below 0: splines, bilinear (`order` 1) or bicubic (3)."""
    side = round(held.force_n.shape[1] ** 0.5)
    if side == SIDE:
        return held
    spread = _spread(side, order)
    fine: Force = np.maximum(spread @ held.force_n.reshape(-1, side, side) @ spread.T, 0)
    return Images(held.ready_ns, fine.reshape(len(fine), -1))


@cache
def _spread(side: int, order: int) -> npt.NDArray[np.float32]:
    """Return the matrix that interpolates `side` cells at `SIDE` places, cell by cell from the edge."""
    columns = [zoom(each, SIDE / side, order=order, mode="nearest", grid_mode=True) for each in np.eye(side)]
    return np.stack(columns, axis=1).astype(np.float32)
