"""The decision graph over pairs of classes: M - 1 of the M (M - 1) / 2 pairs decide (Platt et al. 2000)."""

import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]


def pairs(classes: int) -> list[tuple[int, int]]:
    """Return the pairs ``(i, j)``, i < j, of `classes` classes, in the order of the margins."""
    return [(first, second) for first in range(classes) for second in range(first + 1, classes)]


def walked(margins: Float64, classes: int) -> tuple[npt.NDArray[np.intp], Float64]:
    """Walk from all classes to one class; every step evaluates a pair and excludes a class.

    Parameters
    ----------
    margins : array, shape (count, M (M - 1) / 2)
        In each row one signed margin per pair, positive for the first class of the pair.
    classes : int
        M, at least 2.

    Returns
    -------
    array of intp, shape (count,), and array, shape (count, M - 1)
        The remaining class, and the absolute margins on the path from the root to its leaf.
    """
    rows = np.arange(len(margins))
    low = np.zeros(len(margins), np.intp)
    high = np.full(len(margins), classes - 1, np.intp)
    path = np.empty((len(margins), classes - 1))
    for step in range(classes - 1):
        margin = margins[rows, low * (2 * classes - low - 1) // 2 + high - low - 1]
        path[:, step] = np.abs(margin)
        high -= margin >= 0
        low += margin < 0
    return low, path
