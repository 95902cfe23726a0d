"""The smoothest forces that agree with the known sums, for patches of which sums are unknown.

Of all images with the known sums, take the one with the least ‖Lx‖² + `SLOPE` xᵀLx + `SIZE` ‖x‖², L = DᵀD the Laplacian
of the skin: a thin plate that is held by what is known. The first term carries on the curve of a touch. The last has a
force vanish where nothing is known for ten taxels around, and old forces with it. Conjugate gradients over the unknown
sums; they start from the image before, so a skin that changes little takes few steps. Empty places of boards have no
neighbours, and are held at 0 by `HELD`.
"""

from typing import Any, Final

import numpy as np

from reconstructor.kernels.graph import Graph, laplacian
from reconstructor.kernels.transforms import FAST_MATH, Flat, hadamard
from shell.compiled import njit

#: Weights of slopes and of forces, beside that of 1 for curves.
SLOPE: Final = 0.1
SIZE: Final = 1e-3
#: Weight of forces at empty places: as stiff as the stiffest wave of the grid, so that no more steps are needed.
HELD: Final = 64.0
#: Most steps for each image. One dead patch takes 24 from nothing.
STEPS: Final = 24
#: Enough when the root mean square of the gradient over the unknown taxels is below, newtons.
ENOUGH_N: Final = 1e-6


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def fill(image: Any, taxels: int, graph: Graph, unknown: Any, cells: Any, filled: Any, work: Any) -> int:  # noqa: PLR0917
    """Add to the image what its unknown sums are likely to be; return the number of steps.

    Parameters
    ----------
    image : array of float32, shape (places,)
        Of the known sums alone, taxels, then empty places; changed.
    taxels : int
        n.
    graph : Graph
        Of the taxels.
    unknown : array of bool, shape (patches, taxels)
        Of each patch, which rows of the Sylvester-ordered Hadamard matrix are unknown.
    cells : array of int, shape (patches, taxels)
        Places of each patch; taxels a power of two.
    filled : array of float32, shape (places,)
        What was added to the image before; changed to what is added now.
    work : array of float32, shape (4, places)
        Scratch.
    """
    ahead, gradient, curved, half = work[0], work[1], work[2], work[3]
    patch = np.empty(cells.shape[1], image.dtype)
    enough = image.dtype.type(ENOUGH_N * ENOUGH_N) * _project(filled, unknown, cells, patch)
    for k in range(image.size):
        image[k] += filled[k]
    _bend(image, taxels, graph, half, gradient)
    _project(gradient, unknown, cells, patch)
    rest = image.dtype.type(0)
    for k in range(image.size):
        gradient[k] = ahead[k] = -gradient[k]
        rest += gradient[k] * gradient[k]
    for turn in range(STEPS):
        if rest <= enough:
            return turn
        _bend(ahead, taxels, graph, half, curved)
        _project(curved, unknown, cells, patch)
        along = image.dtype.type(0)
        for k in range(image.size):
            along += ahead[k] * curved[k]
        if along <= 0:
            return turn
        step, before = rest / along, rest
        rest = image.dtype.type(0)
        for k in range(image.size):
            filled[k] += step * ahead[k]
            image[k] += step * ahead[k]
            gradient[k] -= step * curved[k]
            rest += gradient[k] * gradient[k]
        kept = rest / before
        for k in range(image.size):
            ahead[k] = gradient[k] + kept * ahead[k]
    return STEPS


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _project(values: Any, unknown: Any, cells: Any, patch: Flat) -> int:
    """Keep only what changes no known sum; return the number of unknown sums."""
    taxels, total = cells.shape[1], 0
    for block in range(cells.shape[0]):
        count = 0
        for row in range(taxels):
            count += unknown[block, row]
        total += count
        if count == taxels:
            continue
        if count == 0:
            for place in range(taxels):
                values[cells[block, place]] = 0
            continue
        for place in range(taxels):
            patch[place] = values[cells[block, place]]
        hadamard(patch, 1)
        for row in range(taxels):
            patch[row] = patch[row] / taxels if unknown[block, row] else 0
        hadamard(patch, 1)
        for place in range(taxels):
            values[cells[block, place]] = patch[place]
    return total


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _bend(values: Any, taxels: int, graph: Graph, half: Any, bent: Any) -> None:
    """Set bent = (L² + `SLOPE` L + `SIZE`) values, and `HELD` values at empty places."""
    slope, size, held = values.dtype.type(SLOPE), values.dtype.type(SIZE), values.dtype.type(HELD)
    seen, slopes, made = values[:taxels], half[:taxels], bent[:taxels]
    laplacian(seen, slopes, graph)
    for k in range(taxels):
        slopes[k] += slope * seen[k]
    laplacian(slopes, made, graph)
    for k in range(taxels):
        made[k] += size * seen[k]
    for k in range(taxels, values.size):
        bent[k] = held * values[k]
