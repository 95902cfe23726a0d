"""FISTA for SBHE and Haar as one compiled function.

The image is kept in the order of the blocks: row r of block b at ``r * blocks + b``, which makes Φ a Hadamard
transform and a mask. Gradient and momentum are formed there; only the shrinkage goes through the image order.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from reconstructor.kernels.transforms import FAST_MATH, Flat, hadamard, shrink_pyramid, shrink_tensor

Table = npt.NDArray[np.uint16]


class Problem(NamedTuple):
    """What stays the same from cycle to cycle.

    Attributes
    ----------
    sums : shape (m,)
        Place of every sum in block order; places fit uint16, for a grid has at most 256 x 256 taxels.
    to_image, to_blocks : shape (shifts, n)
        Image order from block order and back, one pair for each shift of the basis.
    scalars : shape (4,)
        1 / L, λ / L, 1 / √2 and the least allowed force.
    momentum : shape (iterations,)
        (t_k - 1) / t_{k+1}.
    levels : int
        Levels of the pyramid, 0 for the tensor transform.
    matched : bool
        First take from the start what does not explain the sums.
    """

    sums: Table
    to_image: Table
    to_blocks: Table
    scalars: Flat
    momentum: Flat
    blocks: int
    columns: int
    levels: int
    matched: bool


class Scratch(NamedTuple):
    """Working memory, each of shape (n,)."""

    gain: Flat
    target: Flat
    ahead: Flat
    work: Flat
    image: Flat


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve(estimate: Flat, sums: Flat, valid: npt.NDArray[np.bool_], problem: Problem, scratch: Scratch) -> int:
    """Improve `estimate` in place and return how many sums were valid.

    Parameters
    ----------
    estimate : shape (n,)
        Start and result, newtons, in block order.
    sums, valid : shape (m,)
        Newtons; what they hold where not valid has no effect.
    """
    gain, target, ahead, work, image = scratch
    _, threshold, root_half, floor = problem.scalars
    half = root_half * root_half
    count = _load(sums, valid, problem, scratch)
    if problem.matched:
        _match(estimate, problem.blocks, scratch)
    ahead[:] = estimate
    work[:] = estimate
    for turn in range(problem.momentum.size):
        shift = turn % problem.to_image.shape[0]
        hadamard(work, problem.blocks)
        _subtract_target(work, gain, target)
        hadamard(work, problem.blocks)
        _descend(work, ahead)
        _gather(image, work, problem.to_image[shift])
        if problem.levels:
            shrink_pyramid(image, problem.levels, threshold, half)
        else:
            shrink_tensor(image, problem.columns, threshold, root_half)
        _gather(work, image, problem.to_blocks[shift])
        _advance(work, estimate, ahead, floor, problem.momentum[turn])
    return count


# Each loop is a function of its own: written inside `solve` not all of them are vectorised.


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _subtract_target(work: Flat, gain: Flat, target: Flat) -> None:
    for k in range(work.size):
        work[k] = gain[k] * work[k] - target[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _descend(work: Flat, ahead: Flat) -> None:
    for k in range(work.size):
        work[k] = ahead[k] - work[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _gather(target: Flat, source: Flat, index: Table) -> None:
    for k in range(target.size):
        target[k] = source[index[k]]


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _advance(work: Flat, estimate: Flat, ahead: Flat, floor: Any, momentum: Any) -> None:
    """Take the new estimate from `work`, lift it to `floor`, and leave the next point in `ahead` and `work`."""
    for k in range(work.size):
        new = max(floor, work[k])
        beyond = new + momentum * (new - estimate[k])
        estimate[k] = new
        ahead[k] = beyond
        work[k] = beyond


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _load(sums: Flat, valid: npt.NDArray[np.bool_], problem: Problem, scratch: Scratch) -> int:
    """Write the mask and the masked sums, both times `step`; return how many sums are valid.

    Places of sums that are never sent keep their zeros. An invalid sum enters as a zero of the mask, which is
    exactly the problem without its row.
    """
    gain, target = scratch.gain, scratch.target
    step = problem.scalars[0]
    count = 0
    for k in range(sums.size):
        where = problem.sums[k]
        if valid[k]:
            gain[where] = step
            target[where] = step * sums[k]
            count += 1
        else:
            gain[where] = 0
            target[where] = 0
    return count


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _match(estimate: Flat, blocks: int, scratch: Scratch) -> None:
    """Scale `estimate` by max(0, 2a - 1), where a is the factor, at most 1, that explains the sums best.

    Not by a itself: images of different touches share their noise and a few taxels, and explain a part of each other.
    """
    gain, target, work = scratch.gain, scratch.target, scratch.work
    work[:] = estimate
    hadamard(work, blocks)
    explained = work[0] - work[0]
    energy = explained
    for k in range(work.size):
        seen = gain[k] * work[k]
        explained += seen * target[k]
        energy += seen * seen
    excess = explained + explained - energy
    if excess <= 0:
        estimate[:] = 0
    elif excess < energy:
        estimate *= excess / energy
