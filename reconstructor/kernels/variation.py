"""FISTA for SBHE and total variation with non-negative forces, as one compiled function.

The prior is the anisotropic total variation Σ |x[i+1, j] - x[i, j]| + |x[i, j+1] - x[i, j]| (Rudin, Osher and Fatemi
1992). Its proximal step has no closed form. A few projected gradient steps on its dual (Chambolle 2004) approximate the
step well, because the dual is kept between iterations and cycles.
"""

from typing import Any, Final

from reconstructor.kernels.steps import Cuts, Problem, Table, advance, begin, descend, gather, picture, row
from reconstructor.kernels.transforms import FAST_MATH, Flat
from shell.compiled import njit

#: Rows of working memory: gain, target, ahead, work, image, smoothed, and the dual: down and right.
SCRATCH_ROWS: Final = 8
#: The rows that are state.
DUAL_ROWS: Final = (6, 7)
#: Dual steps in each iteration.
INNER: Final = 3


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_variation(estimate: Flat, sums: Flat, weights: Flat, problem: Problem, scratch: Flat) -> int:
    """Solve in place from `estimate` and return the number of sums used, as `reconstructor.kernels.haar.solve_haar`."""
    columns, threshold, floor = problem.columns, problem.numbers[1], problem.numbers[2]
    half = problem.numbers[3] * problem.numbers[3]
    eighth = half * half * half
    dual = picture(scratch, DUAL_ROWS[0], problem, 0), picture(scratch, DUAL_ROWS[1], problem, 0)
    work, image = row(scratch, 3, estimate.size), picture(scratch, 4, problem, 0)
    smooth, smoothed = picture(scratch, 5, problem, 0), picture(scratch, 5, problem, 1)
    count, kept = begin(estimate, sums, weights, problem, scratch)
    if kept < 1:  # the dual belongs to the start
        for part in dual:
            part[:] *= kept
    for turn in range(problem.momentum.size):
        descend(estimate.size, problem.blocks, scratch)
        gather(image, work, problem.tables[0, 0])
        _clear(image, problem.gaps)
        for _ in range(INNER):
            _smooth(image, smooth, dual, columns, floor)
            _ascend(smooth, dual, columns, threshold, eighth)
            _clear(dual[0], problem.cuts[0])
            _clear(dual[1], problem.cuts[1])
        _smooth(image, smooth, dual, columns, floor)
        gather(work, smoothed, problem.tables[1, 0])
        advance(estimate, floor, problem.momentum[turn], scratch)
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def denoise(image: Flat, limit: Any, steps: int, dual: Flat, smooth: Flat, cuts: Cuts) -> None:  # noqa: PLR0917
    """Write the image with less total variation, not below 0, to `smooth`.

    Parameters
    ----------
    image, smooth : arrays of shape (rows, columns)
    limit : float
        Of the dual, of the image's dtype: the threshold of the proximal step.
    steps : int
        Of the dual.
    dual : array of shape (2, rows, columns)
        Down and right; kept from call to call.
    cuts : two arrays of int
        See `reconstructor.kernels.problem.cuts`.
    """
    columns = image.shape[1]
    seen, made, parts = image.ravel(), smooth.ravel(), (dual[0].ravel(), dual[1].ravel())
    zero, eighth = image.dtype.type(0), image.dtype.type(0.125)
    for _ in range(steps):
        _smooth(seen, made, parts, columns, zero)
        _ascend(made, parts, columns, limit, eighth)
        _clear(parts[0], cuts[0])
        _clear(parts[1], cuts[1])
    _smooth(seen, made, parts, columns, zero)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _clear(values: Flat, where: Table) -> None:
    for k in where:
        values[k] = 0


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _smooth(image: Flat, smooth: Flat, dual: tuple[Flat, Flat], columns: int, floor: Any) -> None:
    """Set smooth = max(floor, image - Dᵀ dual); the dual is 0 after the last row and the last column.

    Slices, because the compiler does not vectorise indices that might be negative.
    """
    down, right = dual
    smooth[0] = max(floor, image[0] + down[0] + right[0])
    made, seen, below, beside = smooth[1:columns], image[1:], down[1:], right[1:]
    for k in range(made.size):
        made[k] = max(floor, seen[k] + below[k] + beside[k] - right[k])
    made, seen, below, beside = smooth[columns:], image[columns:], down[columns:], right[columns:]
    before = right[columns - 1 :]
    for k in range(made.size):
        made[k] = max(floor, seen[k] + below[k] - down[k] + beside[k] - before[k])


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _ascend(smooth: Flat, dual: tuple[Flat, Flat], columns: int, threshold: Any, eighth: Any) -> None:
    """Add the differences of `smooth` / 8 to the dual, and clip it to ±threshold; 8 bounds ‖D Dᵀ‖."""
    down, right = dual
    below, beside = smooth[columns:], smooth[1:]
    for k in range(smooth.size - columns):
        down[k] = max(-threshold, min(threshold, down[k] + eighth * (below[k] - smooth[k])))
    for k in range(smooth.size - 1):
        right[k] = max(-threshold, min(threshold, right[k] + eighth * (beside[k] - smooth[k])))
    for k in range(columns - 1, smooth.size, columns):
        right[k] = 0
