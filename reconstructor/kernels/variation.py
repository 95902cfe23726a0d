"""The default solver: FISTA for sums of blocks, and total variation of forces not below a floor, 0 as a rule.

    min over x ≥ floor of  ½ Σ w (Φx - y)² + λ Σ |x[i] - x[j]|,   i and j neighbours (Rudin, Osher and Fatemi 1992)

D x are the differences of neighbours, u is their dual, kept from iteration to iteration and from solve to solve, and
z = x at first. An iteration (Beck and Teboulle 2009) with the step 1 / L:

    v = z - Φᵀ w (Φ z - y) / L                      `descend`, in block order
    three times:                                    `denoise`: few steps are enough, because u is kept (Chambolle 2004)
        s = max(floor, v - Dᵀ u)                        `smooth`
        u = u + D s / ‖D Dᵀ‖, clipped to ± λ / L        `ascend`
    x' = max(floor, v - Dᵀ u)                           `smooth`
    z = x' + β (x' - x),  x = x'                    `advance`, in block order
"""

from typing import Any, Final

from reconstructor.kernels.blocks import BlockSolver
from reconstructor.kernels.graph import Graph, ascend, smooth
from reconstructor.kernels.steps import Problem, Step, advance, begin, cut, descend, gather
from reconstructor.kernels.transforms import FAST_MATH, Flat
from shell.compiled import njit

#: Dual steps in each iteration.
INNER: Final = 3


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_variation(  # noqa: PLR0917  compiled functions take no keywords
    estimate: Flat, sums: Flat, weights: Flat, problem: Problem, step: Step, memory: Flat
) -> int:
    """Solve in place from `estimate` and return the number of sums used, as `reconstructor.kernels.haar.solve_haar`."""
    buffers = cut(memory, estimate.size, problem.deliver.size, problem.graph.size)
    image, work, smoothed, dual = buffers.image, buffers.work, buffers.smoothed, buffers.dual
    count, kept = begin(estimate, sums, weights, problem, step, buffers)
    if kept < 1:  # the dual belongs to the start
        dual *= kept
    for turn in range(problem.momentum.size):
        descend(buffers, problem.blocks)
        gather(image, work, problem.to_image[0])
        for k in problem.gaps:
            image[k] = 0
        denoise(image, smoothed[: image.size], dual, problem.graph, INNER, step.threshold, step.floor)
        gather(work, smoothed, problem.to_blocks[0])
        advance(estimate, step.floor, problem.momentum[turn], buffers)
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def denoise(  # noqa: PLR0917
    image: Flat, smoothed: Flat, dual: Flat, graph: Graph, steps: int, threshold: Any, floor: Any
) -> None:
    """Write the image with less total variation, not below `floor`, to `smoothed`.

    Parameters
    ----------
    image, smoothed : arrays of shape (n,)
    dual : array of shape (graph.size,)
        Kept from call to call.
    graph : Graph
    steps : int
        Of the dual.
    threshold, floor : float
        Of the image's dtype; the dual stays within ± threshold.
    """
    step = image.dtype.type(1) / image.dtype.type(graph.bound)
    for _ in range(steps):
        smooth(image, smoothed, dual, graph, floor)
        ascend(smoothed, dual, graph, threshold, step)
    smooth(image, smoothed, dual, graph, floor)


class VariationSolver(BlockSolver):
    """`BlockSolver` with the total variation as R."""

    priors = ("variation",)
    iterate = staticmethod(solve_variation)
