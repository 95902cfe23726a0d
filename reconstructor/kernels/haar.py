"""FISTA for SBHE and Haar as one compiled function.

The image is stored in block order: place r of block b at ``r * blocks + b``. In this order Φ is a Hadamard transform
and a mask. Gradient and momentum are computed in block order, the shrinkage in the order of the image.
"""

from typing import Any

from reconstructor.kernels.steps import Problem, advance, begin, descend, gather, row
from reconstructor.kernels.transforms import FAST_MATH, Flat
from shell.compiled import njit

#: Rows of working memory: gain, target, ahead, work, image.
SCRATCH_ROWS = 5


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_haar(estimate: Flat, sums: Flat, weights: Flat, problem: Problem, scratch: Flat) -> int:
    """Solve in place from `estimate` and return the number of sums used.

    Parameters
    ----------
    estimate : shape (n,)
        Start and result, newtons, in block order.
    sums, weights : shape (m,)
        Newtons, and 0 to 1; a sum of weight 0 has no effect.
    scratch : shape (SCRATCH_ROWS, n)
        Zeros at first.
    """
    threshold, floor, root_half = problem.numbers[1], problem.numbers[2], problem.numbers[3]
    half = root_half * root_half
    work, image = row(scratch, 3, estimate.size), row(scratch, 4, estimate.size)
    count, _ = begin(estimate, sums, weights, problem, scratch)
    for turn in range(problem.momentum.size):
        shift = turn % problem.tables.shape[1]
        descend(estimate.size, problem.blocks, scratch)
        gather(image, work, problem.tables[0, shift])
        if problem.levels:
            _shrink_pyramid(image, problem.levels, threshold, half)
        else:
            shrink_tensor(image, problem.columns, threshold, root_half)
        gather(work, image, problem.tables[1, shift])
        advance(estimate, floor, problem.momentum[turn], scratch)
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _shrink_pyramid(work: Flat, levels: int, threshold: Any, half: Any) -> None:
    """Replace the image by Ψ soft(Ψᵀ image) with the Haar pyramid; `work` in the order of `pyramid_addresses`."""
    size = work.size
    for _ in range(levels):
        size //= 4
        p, q, r, s = work[:size], work[size : 2 * size], work[2 * size : 3 * size], work[3 * size : 4 * size]
        for k in range(size):
            a, b = p[k] + q[k], p[k] - q[k]
            c, d = r[k] + s[k], r[k] - s[k]
            x, y, z = half * (b + d), half * (a - c), half * (b - d)
            p[k] = half * (a + c)
            q[k] = x - max(-threshold, min(threshold, x))
            r[k] = y - max(-threshold, min(threshold, y))
            s[k] = z - max(-threshold, min(threshold, z))
    for k in range(size):
        x = work[k]
        work[k] = x - max(-threshold, min(threshold, x))
    for _ in range(levels):
        p, q, r, s = work[:size], work[size : 2 * size], work[2 * size : 3 * size], work[3 * size : 4 * size]
        for k in range(size):
            a, b = p[k] + q[k], p[k] - q[k]
            c, d = r[k] + s[k], r[k] - s[k]
            p[k], q[k], r[k], s[k] = half * (a + c), half * (b + d), half * (a - c), half * (b - d)
        size *= 4


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def shrink_tensor(work: Flat, columns: int, threshold: Any, root_half: Any) -> None:
    """Replace the image by Ψ soft(Ψᵀ image) with the tensor Haar; `work` in the order of `tensor_addresses`."""
    _analyse(work, work.size, columns, root_half)
    _analyse(work, columns, 1, root_half)
    for k in range(work.size):
        x = work[k]
        work[k] = x - max(-threshold, min(threshold, x))
    _synthesise(work, columns, 1, root_half)
    _synthesise(work, work.size, columns, root_half)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _analyse(work: Flat, length: int, width: int, root_half: Any) -> None:
    """Haar-transform each run of `length`, taken as columns of ``(length // width, width)``, along those columns."""
    half = length // 2
    while half >= width:
        for start in range(0, work.size, length):
            low, high = work[start : start + half], work[start + half : start + 2 * half]
            for k in range(half):
                low[k], high[k] = root_half * (low[k] + high[k]), root_half * (low[k] - high[k])
        half //= 2


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _synthesise(work: Flat, length: int, width: int, root_half: Any) -> None:
    """Undo `_analyse`."""
    half = width
    while half < length:
        for start in range(0, work.size, length):
            low, high = work[start : start + half], work[start + half : start + 2 * half]
            for k in range(half):
                low[k], high[k] = root_half * (low[k] + high[k]), root_half * (low[k] - high[k])
        half *= 2
