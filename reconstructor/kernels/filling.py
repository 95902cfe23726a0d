"""The smoothest forces that agree with the known sums, for patches of which sums are unknown.

Of all images with the known sums, take the one with the least ‖Lx‖² + `SLOPE` xᵀLx + `SIZE` ‖x‖², L = DᵀD the Laplacian
of the grid: a thin plate that is held by what is known. The first term carries on the curve of a touch. The last has a
force vanish where nothing is known for ten taxels around, and old forces with it. Conjugate gradients over the unknown
sums; they start from the image before, so a skin that changes little takes few steps.
"""

from typing import Any, Final

import numpy as np

from reconstructor.kernels.transforms import FAST_MATH, Flat, hadamard
from shell.compiled import njit

#: Weights of slopes and of forces, beside that of 1 for curves.
SLOPE: Final = 0.1
SIZE: Final = 1e-3
#: Most steps for each image. One dead patch takes 24 from nothing.
STEPS: Final = 24
#: Enough when the root mean square of the gradient over the unknown taxels is below, newtons.
ENOUGH_N: Final = 1e-6


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def fill(image: Any, unknown: Any, cells: Any, filled: Any, work: Any) -> int:
    """Add to the image what its unknown sums are likely to be; return the number of steps.

    Parameters
    ----------
    image : array of float32, shape (rows, columns)
        Of the known sums alone; changed.
    unknown : array of bool, shape (patches, taxels)
        Of each patch, which rows of the Sylvester-ordered Hadamard matrix are unknown.
    cells : array of int, shape (patches, taxels)
        Row-major indices of the taxels of each patch; taxels a power of two.
    filled : array of float32, shape (rows, columns)
        What was added to the image before; changed to what is added now.
    work : array of float32, shape (4, rows, columns)
        Scratch.
    """
    ahead, gradient, curved, half = work[0], work[1], work[2], work[3]
    patch = np.empty(cells.shape[1], image.dtype)
    enough = image.dtype.type(ENOUGH_N * ENOUGH_N) * _project(filled, unknown, cells, patch)
    added, seen = filled.ravel(), image.ravel()
    for k in range(seen.size):
        seen[k] += added[k]
    _bend(image, half, gradient)
    _project(gradient, unknown, cells, patch)
    left, forth = gradient.ravel(), ahead.ravel()
    rest = image.dtype.type(0)
    for k in range(left.size):
        left[k] = forth[k] = -left[k]
        rest += left[k] * left[k]
    for turn in range(STEPS):
        if rest <= enough:
            return turn
        _bend(ahead, half, curved)
        _project(curved, unknown, cells, patch)
        bent, along = curved.ravel(), image.dtype.type(0)
        for k in range(bent.size):
            along += forth[k] * bent[k]
        if along <= 0:
            return turn
        step, before = rest / along, rest
        rest = image.dtype.type(0)
        for k in range(bent.size):
            added[k] += step * forth[k]
            seen[k] += step * forth[k]
            left[k] -= step * bent[k]
            rest += left[k] * left[k]
        kept = rest / before
        for k in range(bent.size):
            forth[k] = left[k] + kept * forth[k]
    return STEPS


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _project(values: Any, unknown: Any, cells: Any, patch: Flat) -> int:
    """Keep only what changes no known sum; return the number of unknown sums."""
    flat, taxels, total = values.ravel(), cells.shape[1], 0
    for block in range(cells.shape[0]):
        count = 0
        for row in range(taxels):
            count += unknown[block, row]
        total += count
        if count == taxels:
            continue
        if count == 0:
            for place in range(taxels):
                flat[cells[block, place]] = 0
            continue
        for place in range(taxels):
            patch[place] = flat[cells[block, place]]
        hadamard(patch, 1)
        for row in range(taxels):
            patch[row] = patch[row] / taxels if unknown[block, row] else 0
        hadamard(patch, 1)
        for place in range(taxels):
            flat[cells[block, place]] = patch[place]
    return total


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _bend(values: Any, half: Any, bent: Any) -> None:
    """Set bent = (L² + `SLOPE` L + `SIZE`) values."""
    slope, size = values.dtype.type(SLOPE), values.dtype.type(SIZE)
    _laplacian(values, half)
    flat, slopes = values.ravel(), half.ravel()
    for k in range(flat.size):
        slopes[k] += slope * flat[k]
    _laplacian(half, bent)
    made = bent.ravel()
    for k in range(flat.size):
        made[k] += size * flat[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _laplacian(values: Any, made: Any) -> None:
    """Set made = DᵀD values: each taxel's differences from its neighbours, summed."""
    rows, columns = values.shape
    for row in range(rows):
        here, out = values[row], made[row]
        above, below = values[max(row - 1, 0)], values[min(row + 1, rows - 1)]
        for k in range(columns):
            out[k] = 2 * here[k] - above[k] - below[k]
        for k in range(1, columns - 1):
            out[k] += 2 * here[k] - here[k - 1] - here[k + 1]
        out[0] += here[0] - here[1]
        out[columns - 1] += here[columns - 1] - here[columns - 2]
