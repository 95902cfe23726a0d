"""Patches of neighbouring taxels, and the Walsh rows of a patch by sequency.

A board that is wired to its own patch measures blocks of neighbours. The Walsh rows of a patch are products of a
vertical and a horizontal Walsh function; the sequency of each is its number of sign changes. The rows of low sequency
alone give a coarse image, so that sums can be sent in order of weight.
"""

from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.measurement import fast_hadamard

#: Groups of rows: low or high vertical sequency, each with low or high horizontal sequency.
GROUPS: Final = 4

Indices = npt.NDArray[np.intp]


def patch_shape(taxels: int) -> tuple[int, int]:
    """Return height and width of a patch of 2^k taxels: 2^⌊k/2⌋ and 2^⌈k/2⌉."""
    if taxels < 1 or taxels & (taxels - 1):
        raise InputError(f"expected patches of a power of two taxels, got {taxels}")
    high = 1 << (taxels.bit_length() - 1) // 2
    return high, taxels // high


def patches(rows: int, columns: int, taxels: int, blocks: Sequence[int]) -> list[Indices]:
    """Deal patches out to buses, so that a touch meets all buses alike.

    Parameters
    ----------
    rows, columns : int
        The grid, multiples of the patch's height and width.
    taxels : int
        Of one patch.
    blocks : sequence of int
        How many patches each bus takes, in all those of the grid. Of four equal buses, the patch beside one is two
        buses further, the patch below one.

    Returns
    -------
    list of arrays of int, shape (blocks of the bus, taxels)
        Row-major indices, by bus: the taxels of each patch, row by row; the patches row by row.
    """
    high, wide = patch_shape(taxels)
    if rows % high or columns % wide or rows * columns != taxels * sum(blocks):
        raise InputError(
            f"a grid of {rows} x {columns} taxels does not divide into {sum(blocks)} patches of {high} x {wide}"
        )
    cells = np.arange(rows * columns).reshape(rows // high, high, columns // wide, wide).swapaxes(1, 2)
    down, across = np.indices(cells.shape[:2])
    buses = len(blocks)
    bus_of = dealt(((down + max(1, buses // 2) * across) % buses).ravel(), blocks)
    flat = cells.reshape(-1, taxels)
    return [flat[bus_of == bus] for bus in range(buses)]


def dealt(wanted: Indices, blocks: Sequence[int]) -> Indices:
    """Return the bus of every block: the `wanted` bus, or the next that has room; `blocks` counts those of a bus."""
    left, bus_of, buses = list(blocks), np.empty(wanted.size, np.intp), len(blocks)
    for place, first in enumerate(wanted.tolist()):
        bus = next(each % buses for each in range(first, first + buses) if left[each % buses])
        left[bus] -= 1
        bus_of[place] = bus
    return bus_of


@cache
def grouped_rows(taxels: int) -> Indices:
    """Return the rows of the Sylvester-ordered Hadamard matrix of a patch, group by group.

    Parameters
    ----------
    taxels : int
        Of a patch, 4 or more; the patch is read row by row.

    Returns
    -------
    array of int, shape (GROUPS, taxels / GROUPS)
        Group 2·[a ≥ h/2] + [b ≥ w/2] holds the rows of vertical sequency a and horizontal sequency b, by a, then b.
        The first row of group 0 is the sum of all taxels. Group 0 alone is the mean of cells of 2 x 2 taxels.
    """
    high, wide = patch_shape(taxels)
    if high < 2:
        raise InputError(f"expected patches of 4 taxels or more, got {taxels}")
    rows = _by_sequency(high)[:, None] * wide + _by_sequency(wide)
    quarters = rows.reshape(2, high // 2, 2, wide // 2).swapaxes(1, 2)
    return quarters.reshape(GROUPS, -1)


@cache
def walsh_matrix(taxels: int) -> npt.NDArray[np.float32]:
    """Return the Walsh rows of a patch in the order of `grouped_rows`, ±1, shape (taxels, taxels)."""
    return _hadamard(taxels)[grouped_rows(taxels).ravel()].astype(np.float32)


@cache
def haar_matrix(taxels: int) -> npt.NDArray[np.float32]:
    """Return the orthonormal Haar pyramid of a patch, coarse rows first, shape (taxels, taxels).

    A patch that is twice as wide as high is first halved across; every square is then quartered, down to taxels.
    """
    high, wide = patch_shape(taxels)
    rows = [np.ones((high, wide))]
    if wide > high:
        rows.append(np.ones((high, wide)))
        rows[-1][:, high:] = -1
    size = high
    while size > 1:
        half = size // 2
        signs = np.ones(size)
        signs[half:] = -1
        for shape in (np.outer(signs, np.ones(size)), np.outer(np.ones(size), signs), np.outer(signs, signs)):
            for down in range(0, high, size):
                for across in range(0, wide, size):
                    row = np.zeros((high, wide))
                    row[down : down + size, across : across + size] = shape
                    rows.append(row)
        size = half
    flat = np.stack([row.ravel() / np.linalg.norm(row) for row in rows])
    return flat.astype(np.float32)


def _by_sequency(size: int) -> Indices:
    """Return the rows of the Sylvester-ordered Hadamard matrix by their number of sign changes."""
    changes = (np.diff(_hadamard(size), axis=1) != 0).sum(axis=1)
    return np.argsort(changes, kind="stable").astype(np.intp)


def _hadamard(size: int) -> npt.NDArray[np.int64]:
    """Return the Sylvester-ordered Hadamard matrix."""
    return np.asarray(fast_hadamard(np.eye(size, dtype=np.int64)), np.int64)
