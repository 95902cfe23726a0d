"""FISTA for SBHE and total variation with non-negative forces, as one compiled function.

The prior is the anisotropic total variation Σ |x[i+1, j] - x[i, j]| + |x[i, j+1] - x[i, j]| (Rudin, Osher and Fatemi
1992). Its proximal step has no closed form. A few projected gradient steps on its dual (Chambolle 2004) approximate the
step well, because the dual is kept between iterations and cycles.
"""

from typing import Final

import numba

from reconstructor.kernels.steps import Problem, advance, begin, descend, gather, row
from reconstructor.kernels.transforms import FAST_MATH, Flat

#: Rows of working memory: gain, target, ahead, work, image, smoothed, and the dual: down and right.
SCRATCH_ROWS: Final = 8
#: The rows that are state.
DUAL_ROWS: Final = (6, 7)
#: Dual steps in each iteration.
INNER: Final = 3


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_variation(estimate: Flat, sums: Flat, weights: Flat, problem: Problem, scratch: Flat) -> int:
    """Solve in place from `estimate` and return the number of sums used, as `reconstructor.kernels.haar.solve_haar`."""
    floor = problem.numbers[2]
    work, image, smooth = row(scratch, 3, estimate.size), row(scratch, 4, estimate.size), row(scratch, 5, estimate.size)
    count, kept = begin(estimate, sums, weights, problem, scratch)
    if kept < 1:  # the dual belongs to the start
        for number in DUAL_ROWS:
            row(scratch, number, estimate.size)[:] *= kept
    for turn in range(problem.momentum.size):
        descend(estimate.size, problem, scratch)
        gather(image, work, problem.tables[0, 0])
        for _ in range(INNER):
            _smooth(estimate.size, problem, scratch)
            _ascend(estimate.size, problem, scratch)
        _smooth(estimate.size, problem, scratch)
        gather(work, smooth, problem.tables[1, 0])
        advance(estimate, floor, problem.momentum[turn], scratch)
    return count


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _smooth(size: int, problem: Problem, scratch: Flat) -> None:
    """Set smooth = max(floor, image - Dᵀ dual); the dual is 0 after the last row and the last column.

    Slices, because the compiler does not vectorise indices that might be negative.
    """
    image, smooth, down, right = (
        row(scratch, 4, size),
        row(scratch, 5, size),
        row(scratch, 6, size),
        row(scratch, 7, size),
    )
    columns, floor = problem.columns, problem.numbers[2]
    smooth[0] = max(floor, image[0] + down[0] + right[0])
    made, seen, below, beside = smooth[1:columns], image[1:], down[1:], right[1:]
    for k in range(made.size):
        made[k] = max(floor, seen[k] + below[k] + beside[k] - right[k])
    made, seen, below, beside = smooth[columns:], image[columns:], down[columns:], right[columns:]
    before = right[columns - 1 :]
    for k in range(made.size):
        made[k] = max(floor, seen[k] + below[k] - down[k] + beside[k] - before[k])


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _ascend(size: int, problem: Problem, scratch: Flat) -> None:
    """Add the differences of ``smooth`` / 8 to the dual, and clip it to ±threshold; 8 bounds ‖D Dᵀ‖."""
    smooth, down, right = row(scratch, 5, size), row(scratch, 6, size), row(scratch, 7, size)
    columns, threshold, half = problem.columns, problem.numbers[1], problem.numbers[3] * problem.numbers[3]
    eighth = half * half * half
    below, beside = smooth[columns:], smooth[1:]
    for k in range(size - columns):
        down[k] = max(-threshold, min(threshold, down[k] + eighth * (below[k] - smooth[k])))
    for k in range(size - 1):
        right[k] = max(-threshold, min(threshold, right[k] + eighth * (beside[k] - smooth[k])))
    for k in range(columns - 1, size, columns):
        right[k] = 0
