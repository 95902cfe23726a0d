"""Common steps of the compiled solvers: load sums, gradient step, momentum, delivery of the image."""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from reconstructor.checks import LARGEST_N
from reconstructor.kernels.graph import GAP, Graph
from reconstructor.kernels.transforms import FAST_MATH, Flat, hadamard, masked_gram
from shell.compiled import njit

Table = npt.NDArray[np.uint16]


class Problem(NamedTuple):
    """Constants of a solver, the same in all cycles.

    Attributes
    ----------
    places : shape (m,)
        Place of every sum in block order; uint16 is enough, because a grid has at most 256 x 256 taxels.
    tables : shape (2, shifts, larger of places and n)
        From block order to the prior's image order, and back, a pair for each shift of the basis.
    deliver : shape (n,)
        From block order to row-major order.
    numbers : shape (5,)
        1 / L, λ / L, the smallest allowed force, the 1 / √2 of the transforms, and the step of the dual of total
        variation.
    momentum : shape (iterations,)
        (t_k - 1) / t_{k+1}.
    blocks, rows, columns : int
    levels : int
        Levels of a pyramid, 0 for a tensor transform.
    scaled_start : bool
        See `SolverSettings`.
    gaps : shape (gaps,)
        Taxels that the grid lacks, in the prior's image order.
    graph : Graph
        Neighbours in the prior's image order.
    """

    places: Table
    tables: npt.NDArray[np.uint16]
    deliver: Table
    numbers: Flat
    momentum: Flat
    blocks: int
    rows: int
    columns: int
    levels: int
    scaled_start: bool
    gaps: Table
    graph: Graph


CACHE_LINE: Final = 64


def scratch_of(rows: int, size: int, dtype: np.dtype[Any], more: int = 0) -> Flat:
    """Return working memory of `rows` rows of `size`, and `more` values after them, zeros; `row` returns a row."""
    return aligned(rows * (size + GAP) + more, dtype)


def aligned(size: int, dtype: np.dtype[Any]) -> Flat:
    """Return zeros aligned to a cache line: vectors that cross cache lines cost a tenth of the time."""
    extra = CACHE_LINE // dtype.itemsize
    memory = np.zeros(size + extra, dtype)
    first = -memory.ctypes.data % CACHE_LINE // dtype.itemsize
    return memory[first : first + size]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def row(scratch: Flat, number: int, size: int) -> Flat:
    """Return one row of working memory."""
    start = number * (size + GAP)
    return scratch[start : start + size]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def picture(scratch: Flat, number: int, problem: Problem, more: int) -> Flat:
    """Return one row of working memory, of the size of the grid and of `more` values, at most `GAP`, which are 0.

    `row` returns rows of the size of all places; no row with a lower number than that of a picture reaches it.
    """
    start = number * (problem.tables.shape[2] + GAP)
    return scratch[start : start + problem.rows * problem.columns + more]


# Compiled functions take no keyword arguments.
# Each loop is a separate function: inside the solvers some loops would not be vectorised.


@njit(cache=True, nogil=True)
def usable(sums: Flat, weights: Flat) -> bool:
    """Tell whether all weights are 0 to 1, and all sums of weight above 0 are numbers up to `LARGEST_N`."""
    good = 0  # no early return: such a loop is vectorised
    for k in range(sums.size):
        counts = (weights[k] > 0) & (weights[k] <= 1) & (abs(sums[k]) <= LARGEST_N)  # NaN fails
        good += (weights[k] == 0) | counts
    return good == sums.size


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def begin(estimate: Flat, sums: Flat, weights: Flat, problem: Problem, scratch: Flat) -> tuple[int, Any]:
    """Fill `scratch` (gain, target, ahead, work, …) for the first iteration.

    Return the number of sums used, and the factor of the start.
    """
    size = estimate.size
    gain, target, ahead, work = (
        row(scratch, 0, size),
        row(scratch, 1, size),
        row(scratch, 2, size),
        row(scratch, 3, size),
    )
    count = load(sums, weights, problem.places, problem.numbers[0], gain, target)
    kept = estimate.dtype.type(1)
    if problem.scaled_start:
        kept = _scale_start(estimate, gain, target, work, problem.blocks)
    ahead[:] = estimate
    work[:] = estimate
    return count, kept


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def load(sums: Flat, weights: Flat, places: Table, step: Any, gain: Flat, target: Flat) -> int:  # noqa: PLR0917
    """Write the mask and the masked sums, both times `step`; return the number of sums used.

    Places of Hadamard rows that are not sent stay 0. A sum of weight 0 is a zero of the mask: the problem without its
    row.
    """
    count = 0
    for k in range(sums.size):
        where = places[k]
        if weights[k] > 0:
            gain[where] = step * weights[k]
            target[where] = step * weights[k] * sums[k]
            count += 1
        else:
            gain[where] = 0
            target[where] = 0
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def descend(size: int, blocks: int, scratch: Flat) -> None:
    """Compute a gradient step from ``ahead``, equal to ``work``; the result is in ``work``."""
    gain, target, ahead, work = (
        row(scratch, 0, size),
        row(scratch, 1, size),
        row(scratch, 2, size),
        row(scratch, 3, size),
    )
    masked_gram(work, gain, target, blocks)
    for k in range(work.size):
        work[k] = ahead[k] - work[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def gather(target: Flat, source: Flat, index: Table) -> None:
    """Set target[k] = source[index[k]]."""
    for k in range(target.size):
        target[k] = source[index[k]]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def advance(estimate: Flat, floor: Any, momentum: Any, scratch: Flat) -> None:
    """Set the estimate to max(``work``, `floor`), and write the next point to ``ahead`` and ``work``."""
    ahead, work = row(scratch, 2, estimate.size), row(scratch, 3, estimate.size)
    for k in range(work.size):
        new = max(floor, work[k])
        beyond = new + momentum * (new - estimate[k])
        estimate[k] = new
        ahead[k] = beyond
        work[k] = beyond


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def deliver(image: npt.NDArray[np.float32], estimate: Flat, index: Table) -> None:
    """Write the image row by row, negative forces as 0."""
    for k in range(image.size):
        image[k] = max(np.float32(0), np.float32(estimate[index[k]]))


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _scale_start(estimate: Flat, gain: Flat, target: Flat, work: Flat, blocks: int) -> Any:
    """Scale `estimate` by max(0, 2a - 1) and return this factor, with a = argmin ‖a Φ estimate - y‖, at most 1.

    Not by a itself: images of different touches share some taxels and their noise, so a is above 0 for another touch.
    """
    work[:] = estimate
    hadamard(work, blocks)
    explained = energy = estimate.dtype.type(0)
    for k in range(work.size):
        seen = gain[k] * work[k]
        explained += seen * target[k]
        energy += seen * seen
    excess = explained + explained - energy
    if excess >= energy:  # also if both are 0
        return estimate.dtype.type(1)
    scale = max(estimate.dtype.type(0), excess / energy)
    estimate *= scale
    return scale
