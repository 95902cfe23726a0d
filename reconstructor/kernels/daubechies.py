"""FISTA for SBHE and D4, tensor or pyramid, as one compiled function.

Every level transforms the columns, so that whole rows are added; between the directions the image is transposed. The
low half of a level is first and contiguous; the next level uses this half only.
"""

from typing import Any, Final

from reconstructor.kernels.steps import Problem, advance, begin, descend, gather, row
from reconstructor.kernels.transforms import FAST_MATH, Flat, transpose_image
from shell.compiled import njit

#: Rows of working memory: gain, target, ahead, work, image, other.
SCRATCH_ROWS: Final = 6


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_daubechies(estimate: Flat, sums: Flat, weights: Flat, problem: Problem, scratch: Flat) -> int:
    """Solve in place from `estimate` and return the number of sums used, as `reconstructor.kernels.haar.solve_haar`."""
    threshold, floor, taps = problem.numbers[1], problem.numbers[2], problem.numbers[4:8]
    work, image, other = row(scratch, 3, estimate.size), row(scratch, 4, estimate.size), row(scratch, 5, estimate.size)
    count, _ = begin(estimate, sums, weights, problem, scratch)
    for turn in range(problem.momentum.size):
        shift = turn % problem.tables.shape[1]
        descend(estimate.size, problem.blocks, scratch)
        gather(image, work, problem.tables[0, shift])
        if problem.levels:
            _shrink_pyramid(image, other, problem, threshold, taps)
        else:
            _shrink_tensor(image, other, problem, threshold, taps)
        gather(work, image, problem.tables[1, shift])
        advance(estimate, floor, problem.momentum[turn], scratch)
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _soft(work: Flat, threshold: Any) -> None:
    for k in range(work.size):
        work[k] = work[k] - max(-threshold, min(threshold, work[k]))


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _shrink_tensor(image: Flat, other: Flat, problem: Problem, threshold: Any, taps: Flat) -> None:
    """Replace the image by Ψ soft(Ψᵀ image) with the tensor D4."""
    rows, columns = problem.rows, problem.columns
    _analyse(image, other, rows, columns, taps)
    transpose_image(other, image, rows, columns)
    _analyse(other, image, columns, rows, taps)
    _soft(other, threshold)
    _synthesise(other, image, columns, rows, taps)
    transpose_image(image, other, columns, rows)
    _synthesise(image, other, rows, columns, taps)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _analyse(work: Flat, other: Flat, height: int, width: int, taps: Flat) -> None:
    while height > 1:
        part, spare = work[: height * width], other[: height * width]
        _split(spare, part, width, taps)
        part[:] = spare
        height //= 2


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _synthesise(work: Flat, other: Flat, height: int, width: int, taps: Flat) -> None:
    size = 2 * width
    while size <= height * width:
        part, spare = work[:size], other[:size]
        _join(spare, part, width, taps)
        part[:] = spare
        size *= 2


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _shrink_pyramid(image: Flat, other: Flat, problem: Problem, threshold: Any, taps: Flat) -> None:
    """Replace the image by Ψ soft(Ψᵀ image) with the D4 pyramid.

    Each level stores its quadrants one after the other, transposed; the next level transforms the first quadrant.
    """
    height, width = problem.rows, problem.columns
    for _ in range(problem.levels):
        size = height * width
        half = size // 2
        _split(other[:size], image[:size], width, taps)
        for start in (0, half):
            part = image[start : start + half]
            transpose_image(part, other[start : start + half], height // 2, width)
            _split(other[start : start + half], part, height // 2, taps)
        image[:size] = other[:size]
        height, width = width // 2, height // 2
    _soft(image, threshold)
    for _ in range(problem.levels):
        height, width = 2 * width, 2 * height
        size = height * width
        half = size // 2
        for start in (0, half):
            part, spare = image[start : start + half], other[start : start + half]
            _join(spare, part, height // 2, taps)
            transpose_image(part, spare, width, height // 2)
        _join(other[:size], image[:size], width, taps)
        image[:size] = other[:size]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _split(target: Flat, source: Flat, width: int, taps: Flat) -> None:
    """One level along the columns: row k of the low half is computed from rows 2k to 2k + 3 of the source."""
    a, b, c, d = taps[0], taps[1], taps[2], taps[3]
    size = source.size
    for k in range(size // (2 * width)):
        here, there = 2 * k * width, (2 * k + 2) * width % size
        p, q = source[here : here + width], source[here + width : here + 2 * width]
        r, s = source[there : there + width], source[there + width : there + 2 * width]
        low = target[k * width : (k + 1) * width]
        high = target[size // 2 + k * width : size // 2 + (k + 1) * width]
        for j in range(width):
            low[j] = a * p[j] + b * q[j] + c * r[j] + d * s[j]
            high[j] = d * p[j] - c * q[j] + b * r[j] - a * s[j]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _join(target: Flat, source: Flat, width: int, taps: Flat) -> None:
    """Undo `_split`."""
    a, b, c, d = taps[0], taps[1], taps[2], taps[3]
    half = source.size // 2
    for k in range(half // width):
        here, before = k * width, (k * width - width) % half
        p, q = source[here : here + width], source[before : before + width]
        r, s = source[half + here : half + here + width], source[half + before : half + before + width]
        even = target[2 * here : 2 * here + width]
        odd = target[2 * here + width : 2 * here + 2 * width]
        for j in range(width):
            even[j] = a * p[j] + c * q[j] + d * r[j] + b * s[j]
            odd[j] = b * p[j] + d * q[j] - c * r[j] - a * s[j]
