"""Steps of the compiled solvers of sums of blocks, and the arrays that the steps work on.

In block order place r of block b is at ``r * blocks + b``: there Φ is a Hadamard transform of every column and a mask.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from reconstructor.checks import LARGEST_N
from reconstructor.kernels.graph import GAP, Graph
from reconstructor.kernels.transforms import FAST_MATH, Flat, hadamard, masked_gram
from shell.compiled import njit

Table = npt.NDArray[np.uint16]


class Problem(NamedTuple):
    """What a solver of sums of blocks knows before the sums come.

    Attributes
    ----------
    places : shape (m,)
        Place of every sum in block order; uint16 is enough, because a grid has at most 256 x 256 taxels.
    to_image, to_blocks : shapes (shifts, n) and (shifts, places)
        From block order to the prior's image order, and back, for each shift of the basis.
    deliver : shape (n,)
        From block order to row-major order.
    gaps : shape (gaps,)
        Taxels that the grid lacks, in the prior's image order.
    graph : Graph
        Neighbours in the prior's image order.
    momentum : shape (iterations,)
        β = (t_k - 1) / t_{k+1}.
    blocks, rows, columns : int
    levels : int
        Levels of a pyramid, 0 for a tensor transform.
    scaled_start : bool
        See `SolverSettings`.
    """

    places: Table
    to_image: npt.NDArray[np.uint16]
    to_blocks: npt.NDArray[np.uint16]
    deliver: Table
    gaps: Table
    graph: Graph
    momentum: Flat
    blocks: int
    rows: int
    columns: int
    levels: int
    scaled_start: bool


class Step(NamedTuple):
    """The numbers of a step, of the dtype of the solver: 1 / L, λ / L, and the smallest allowed force."""

    size: Any
    threshold: Any
    floor: Any


class Buffers(NamedTuple):
    """Working memory; the dual is state.

    Attributes
    ----------
    gain, target : shape (places,)
        w / L and w y / L of the sums, in block order; 0 where no sum is sent.
    ahead, work : shape (places,)
        z, from which the next step starts, in block order, and its copy in which steps are computed.
    image : shape (n,)
        In the prior's image order.
    smoothed : shape (n + 1,)
        The same with less total variation, then a 0 for empty places.
    dual : shape (graph.size,)
        Of total variation.
    """

    gain: Flat
    target: Flat
    ahead: Flat
    work: Flat
    image: Flat
    smoothed: Flat
    dual: Flat


def memory_of(places: int, taxels: int, dual: int, dtype: np.dtype[Any]) -> Flat:
    """Return the memory that `cut` makes buffers of, zeros."""
    return aligned(6 * (max(places, taxels) + GAP) + dual, dtype)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def cut(memory: Flat, places: int, taxels: int, dual: int) -> Buffers:
    """Return the arrays in a piece of memory: a call takes one argument sooner than seven."""
    stride = max(places, taxels) + GAP
    return Buffers(
        memory[:places],
        memory[stride : stride + places],
        memory[2 * stride : 2 * stride + places],
        memory[3 * stride : 3 * stride + places],
        memory[4 * stride : 4 * stride + taxels],
        memory[5 * stride : 5 * stride + taxels + 1],
        memory[6 * stride : 6 * stride + dual],
    )


CACHE_LINE: Final = 64


def aligned(size: int, dtype: np.dtype[Any]) -> Flat:
    """Return zeros aligned to a cache line: vectors that cross cache lines cost a tenth of the time."""
    extra = CACHE_LINE // dtype.itemsize
    memory = np.zeros(size + extra, dtype)
    first = -memory.ctypes.data % CACHE_LINE // dtype.itemsize
    return memory[first : first + size]


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
def begin(  # noqa: PLR0917
    estimate: Flat, sums: Flat, weights: Flat, problem: Problem, step: Step, buffers: Buffers
) -> tuple[int, Any]:
    """Fill the buffers for the first iteration; return the number of sums used, and the factor of the start."""
    count = load(sums, weights, problem.places, step.size, buffers.gain, buffers.target)
    kept = estimate.dtype.type(1)
    if problem.scaled_start:
        kept = _scale_start(estimate, buffers.gain, buffers.target, buffers.work, problem.blocks)
    buffers.ahead[:] = estimate
    buffers.work[:] = estimate
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
def descend(buffers: Buffers, blocks: int) -> None:
    """Step down the gradient: ``work`` = z - Φᵀ w (Φ z - y) / L, from z in ``ahead`` and ``work``."""
    ahead, work = buffers.ahead, buffers.work
    masked_gram(work, buffers.gain, buffers.target, blocks)
    for k in range(work.size):
        work[k] = ahead[k] - work[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def gather(target: Flat, source: Flat, index: Table) -> None:
    """Set target[k] = source[index[k]]."""
    for k in range(target.size):
        target[k] = source[index[k]]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def advance(estimate: Flat, floor: Any, momentum: Any, buffers: Buffers) -> None:
    """Set x to x' = max(``work``, floor), and z, in ``ahead`` and ``work``, to x' + β (x' - x)."""
    ahead, work = buffers.ahead, buffers.work
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
