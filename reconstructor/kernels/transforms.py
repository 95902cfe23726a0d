"""The transforms of the kernel, in place on flat arrays, float32 or float64.

Flat arrays and constant offsets, because the compiler vectorises these loops and not those over two subscripts.
"""

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

#: Sums of counts hold no NaN; the order of additions stays as written, so that results are repeatable.
FAST_MATH = {"nnan", "ninf", "nsz", "contract"}

Flat = npt.NDArray[np.floating[Any]]


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def hadamard(work: Flat, blocks: int) -> None:
    """Transform every column of ``work.reshape(B, blocks)`` by the B x B Hadamard matrix of ±1."""
    total = work.size
    half = blocks
    while 2 * half < total:  # two levels in one pass
        for start in range(0, total, 4 * half):
            first = work[start : start + half]
            second = work[start + half : start + 2 * half]
            third = work[start + 2 * half : start + 3 * half]
            fourth = work[start + 3 * half : start + 4 * half]
            for k in range(half):
                a, b = first[k] + second[k], first[k] - second[k]
                c, d = third[k] + fourth[k], third[k] - fourth[k]
                first[k], second[k], third[k], fourth[k] = a + c, b + d, a - c, b - d
        half *= 4
    if half < total:
        first = work[:half]
        second = work[half:]
        for k in range(half):
            first[k], second[k] = first[k] + second[k], first[k] - second[k]


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def shrink_pyramid(work: Flat, levels: int, threshold: Any, half: Any) -> None:
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


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def shrink_tensor(work: Flat, columns: int, threshold: Any, root_half: Any) -> None:
    """Replace the image by Ψ soft(Ψᵀ image) with the tensor Haar; `work` in the order of `tensor_addresses`."""
    _analyse(work, work.size, columns, root_half)
    _analyse(work, columns, 1, root_half)
    for k in range(work.size):
        x = work[k]
        work[k] = x - max(-threshold, min(threshold, x))
    _synthesise(work, columns, 1, root_half)
    _synthesise(work, work.size, columns, root_half)


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _analyse(work: Flat, length: int, width: int, root_half: Any) -> None:
    """Haar-transform each run of `length`, taken as columns of ``(length // width, width)``, along those columns."""
    half = length // 2
    while half >= width:
        for start in range(0, work.size, length):
            low, high = work[start : start + half], work[start + half : start + 2 * half]
            for k in range(half):
                low[k], high[k] = root_half * (low[k] + high[k]), root_half * (low[k] - high[k])
        half //= 2


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _synthesise(work: Flat, length: int, width: int, root_half: Any) -> None:
    """Undo `_analyse`."""
    half = width
    while half < length:
        for start in range(0, work.size, length):
            low, high = work[start : start + half], work[start + half : start + 2 * half]
            for k in range(half):
                low[k], high[k] = root_half * (low[k] + high[k]), root_half * (low[k] - high[k])
        half *= 2
