"""FISTA for sums of blocks and the l1 norm of Haar coefficients.

An iteration is that of `reconstructor.kernels.variation`, with Ψ soft(Ψᵀ v, λ / L) in place of less total variation; Ψ
is another shift of the basis in each.
"""

from typing import Any

from reconstructor.kernels.blocks import BlockSolver
from reconstructor.kernels.steps import Problem, Step, advance, begin, cut, descend, gather
from reconstructor.kernels.transforms import FAST_MATH, Flat
from shell.compiled import njit


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_haar(  # noqa: PLR0917  compiled functions take no keywords
    estimate: Flat, sums: Flat, weights: Flat, problem: Problem, step: Step, memory: Flat
) -> int:
    """Solve in place from `estimate` and return the number of sums used.

    Parameters
    ----------
    estimate : shape (places,)
        Start and result, newtons, in block order.
    sums, weights : shape (m,)
        Newtons, and 0 to 1; a sum of weight 0 has no effect.
    """
    buffers = cut(memory, estimate.size, problem.deliver.size, problem.graph.size)
    image, work = buffers.image, buffers.work
    root_half = estimate.dtype.type(0.5**0.5)
    count, _ = begin(estimate, sums, weights, problem, step, buffers)
    for turn in range(problem.momentum.size):
        shift = turn % problem.to_image.shape[0]
        descend(buffers, problem.blocks)
        gather(image, work, problem.to_image[shift])
        if problem.levels:
            _shrink_pyramid(image, problem.levels, step.threshold, root_half * root_half)
        else:
            shrink_tensor(image, problem.columns, step.threshold, root_half)
        gather(work, image, problem.to_blocks[shift])
        advance(estimate, step.floor, problem.momentum[turn], buffers)
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


class HaarSolver(BlockSolver):
    """`BlockSolver` with the l1 norm of the Haar pyramid or tensor as R."""

    priors = ("haar-pyramid", "haar-tensor")
    iterate = staticmethod(solve_haar)
