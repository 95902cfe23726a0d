"""The seven arrays of the paper: 256 mm square, from 64 x 64 taxels to one (section V).

The paper does not define its coarse taxels. Two interpretations are used::

    averaged   the mean of the taxels in each cell of the 64 x 64 array: reproduces the paper's accuracies
    large      one sphere that fills its cell; radius half the pitch
"""

from typing import Final, Literal

import numpy as np

from canskin.errors import InputError
from touch.contact import Force, Grid

Kind = Literal["averaged", "large"]

#: Taxels along one side; 4096, 1024, 256, 64, 16, 4 and 1 taxels.
ARRAYS: Final = (64, 32, 16, 8, 4, 2, 1)
FINE_SIDE: Final = ARRAYS[0]
SIDE_M: Final = 0.256


def grid_of(side: int, kind: Kind = "large") -> Grid:
    """Return the array of `side` x `side` spheres on 256 mm, `side` one of `ARRAYS`.

    For ``averaged`` this is the fine array, whose cells `averaged` averages.
    """
    _check(side)
    if kind == "averaged":
        side = FINE_SIDE
    pitch_m = SIDE_M / side
    return Grid(side, side, pitch_m, pitch_m / 2)


def averaged(force_n: Force, side: int) -> Force:
    """Return the mean force of the taxels in each of `side` x `side` cells.

    Parameters
    ----------
    force_n : numpy.ndarray
        Shape (..., 64, 64), newtons.
    side : int
        One of `ARRAYS`.

    Returns
    -------
    numpy.ndarray
        float32, shape (..., side, side), newtons.
    """
    _check(side)
    if force_n.shape[-2:] != (FINE_SIDE, FINE_SIDE):
        raise InputError(f"expected forces of shape (..., {FINE_SIDE}, {FINE_SIDE}), got {force_n.shape}")
    if side == FINE_SIDE:
        return force_n
    rows = np.kron(np.eye(side, dtype=np.float32), np.full(FINE_SIDE // side, side / FINE_SIDE, np.float32))
    means: Force = rows @ force_n @ rows.T
    return means


def _check(side: int) -> None:
    if side not in ARRAYS:
        raise InputError(f"unknown array side {side}: expected one of {', '.join(map(str, ARRAYS))}")
