"""FISTA for SBHE and total variation with non-negative forces, as one compiled function.

The prior is the anisotropic total variation Σ |x[i] - x[j]| over the edges of the skin (Rudin, Osher and Fatemi 1992).
Its proximal step has no closed form. A few projected gradient steps on its dual (Chambolle 2004) approximate the step
well, because the dual is kept between iterations and cycles.
"""

from typing import Any, Final

from reconstructor.kernels.graph import Graph, ascend, smooth
from reconstructor.kernels.steps import Problem, advance, begin, descend, gather, picture, row
from reconstructor.kernels.transforms import FAST_MATH, Flat
from shell.compiled import njit

#: Rows of working memory: gain, target, ahead, work, image, smoothed; the dual follows, which is state.
SCRATCH_ROWS: Final = 6
#: Dual steps in each iteration.
INNER: Final = 3


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_variation(estimate: Flat, sums: Flat, weights: Flat, problem: Problem, scratch: Flat) -> int:
    """Solve in place from `estimate` and return the number of sums used, as `reconstructor.kernels.haar.solve_haar`."""
    graph, threshold, floor, step = problem.graph, problem.numbers[1], problem.numbers[2], problem.numbers[4]
    dual = scratch[scratch.size - graph.size :]
    work, image = row(scratch, 3, estimate.size), picture(scratch, 4, problem, 0)
    made, padded = picture(scratch, 5, problem, 0), picture(scratch, 5, problem, 1)
    count, kept = begin(estimate, sums, weights, problem, scratch)
    if kept < 1:  # the dual belongs to the start
        dual *= kept
    for turn in range(problem.momentum.size):
        descend(estimate.size, problem.blocks, scratch)
        gather(image, work, problem.tables[0, 0])
        for k in problem.gaps:
            image[k] = 0
        for _ in range(INNER):
            smooth(image, made, dual, graph, floor)
            ascend(made, dual, graph, threshold, step)
        smooth(image, made, dual, graph, floor)
        gather(work, padded, problem.tables[1, 0])
        advance(estimate, floor, problem.momentum[turn], scratch)
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def denoise(image: Flat, limit: Any, steps: int, dual: Flat, made: Flat, graph: Graph) -> None:  # noqa: PLR0917
    """Write the image with less total variation, not below 0, to `made`.

    Parameters
    ----------
    image, made : arrays of shape (n,)
    limit : float
        Of the dual, of the image's dtype: the threshold of the proximal step.
    steps : int
        Of the dual.
    dual : array of shape (graph.size,)
        Kept from call to call.
    graph : Graph
    """
    zero, step = image.dtype.type(0), image.dtype.type(1) / image.dtype.type(graph.bound)
    for _ in range(steps):
        smooth(image, made, dual, graph, zero)
        ascend(made, dual, graph, limit, step)
    smooth(image, made, dual, graph, zero)
