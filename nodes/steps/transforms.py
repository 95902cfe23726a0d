"""The orthonormal Haar pyramid and the Walsh sums of patches, by additions in one defined order.

The order matters: the boards' C code (`nodes/firmware/c/steps`) adds in the same order, so that both round alike.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.patch_filter import ROOT_HALF, Floats
from shell.compiled import njit

_HALF: Final = np.float32(0.5)


@njit(cache=True, nogil=True)
def to_haar(value: Floats, high: int, wide: int, into: Floats) -> None:
    """Write the Haar coefficients of patches of `high` x `wide` taxels; arrays of shape (nodes, taxels).

    The coefficients are in the order of `skin.walsh.haar_matrix`. `value` is overwritten.
    """
    for node in range(value.shape[0]):
        mean, coefficient = value[node], into[node]
        rows, columns, end = high, wide, high * wide
        while rows > 1:
            squares = rows * columns // 4
            end -= 3 * squares
            for row in range(0, rows, 2):
                for column in range(0, columns, 2):
                    first, place = row * columns + column, row * columns // 4 + column // 2
                    top, bottom = mean[first] + mean[first + 1], mean[first + columns] + mean[first + columns + 1]
                    upper, lower = mean[first] - mean[first + 1], mean[first + columns] - mean[first + columns + 1]
                    mean[place] = (top + bottom) * _HALF
                    coefficient[end + place] = (top - bottom) * _HALF
                    coefficient[end + squares + place] = (upper + lower) * _HALF
                    coefficient[end + 2 * squares + place] = (upper - lower) * _HALF
            rows, columns = rows // 2, columns // 2
        coefficient[0] = mean[0]
        if columns == 2:
            coefficient[0] = (mean[0] + mean[1]) * ROOT_HALF
            coefficient[1] = (mean[0] - mean[1]) * ROOT_HALF


@njit(cache=True, nogil=True)
def from_haar(coefficients: Floats, high: int, wide: int, into: Floats) -> None:
    """Write what patches have the given Haar coefficients: the inverse of `to_haar`."""
    for node in range(coefficients.shape[0]):
        mean, coefficient = into[node], coefficients[node]
        rows, columns, end = 1, wide // high, wide // high
        mean[0] = coefficient[0]
        if columns == 2:
            mean[0] = (coefficient[0] + coefficient[1]) * ROOT_HALF
            mean[1] = (coefficient[0] - coefficient[1]) * ROOT_HALF
        while rows < high:
            squares, rows, columns = rows * columns, 2 * rows, 2 * columns
            # From the last square on: no value is overwritten before it is read.
            for row in range(rows - 2, -1, -2):
                for column in range(columns - 2, -1, -2):
                    first, place = row * columns + column, row * columns // 4 + column // 2
                    whole, down = mean[place], coefficient[end + place]
                    across, both = coefficient[end + squares + place], coefficient[end + 2 * squares + place]
                    mean[first] = ((whole + down) + (across + both)) * _HALF
                    mean[first + 1] = ((whole + down) - (across + both)) * _HALF
                    mean[first + columns] = ((whole - down) + (across - both)) * _HALF
                    mean[first + columns + 1] = ((whole - down) - (across - both)) * _HALF
            end += 3 * squares


@njit(cache=True, nogil=True)
def to_walsh(value: Floats, order: npt.NDArray[np.intp], work: Floats, into: Floats) -> None:
    """Write the Walsh sums of patches: the rows `order` of a fast Hadamard transform (docs/firmware.md, "Sums").

    Parameters
    ----------
    value, into : arrays of float32, shape (nodes, taxels)
    order : array of int, shape (taxels,)
        See `skin.walsh.grouped_rows`.
    work : array of float32, shape (taxels,)
    """
    size = order.size
    for node in range(value.shape[0]):
        work[:] = value[node]
        half = 1
        while half < size:
            for first in range(0, size, 2 * half):
                for place in range(first, first + half):
                    above, below = work[place], work[place + half]
                    work[place], work[place + half] = above + below, above - below
            half *= 2
        for place in range(size):
            into[node, place] = work[order[place]]


@njit(cache=True, nogil=True)
def to_walsh_variance(
    nodes: npt.NDArray[np.intp], variance: Floats, noise: Floats, spread: Floats, into: Floats
) -> None:
    """Write the variances of Walsh sums of some nodes from those of Haar coefficients, `variance` · `noise`².

    Parameters
    ----------
    nodes : array of int
    variance, noise, into : arrays of float32, shape (nodes, taxels)
    spread : array of float32, shape (taxels, taxels)
        Squares of the Walsh sums of the rows of the pyramid: 0 or a power of two, so every product is exact.
    """
    size = spread.shape[0]
    for node in nodes:
        total = into[node]
        total[:] = 0
        for coefficient in range(size):
            of_coefficient = variance[node, coefficient] * (noise[node, coefficient] * noise[node, coefficient])
            for place in range(size):
                total[place] += of_coefficient * spread[coefficient, place]
