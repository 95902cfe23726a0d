"""The transforms of the kernels, in place on flat arrays, float32 or float64.

Flat arrays and slices, because the compiler vectorises these loops, but not loops over two subscripts.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from shell.compiled import njit

#: Sums contain no NaN; the order of additions is kept, so that results are repeatable.
FAST_MATH = {"nnan", "ninf", "nsz", "contract"}

Flat = npt.NDArray[np.floating[Any]]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def hadamard(work: Flat, blocks: int) -> None:
    """Transform every column of ``work.reshape(B, blocks)`` by the B x B Hadamard matrix of ±1."""
    _butterflies(work, blocks, work.size)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def masked_gram(work: Flat, gain: Flat, target: Flat, blocks: int) -> None:
    """Replace every column w of ``work.reshape(B, blocks)`` by H (gain · H w - target).

    The two highest levels of both transforms, and the operation between them, are one pass.
    """
    size = work.size // 4
    if size < blocks:  # B = 2
        _butterflies(work, blocks, work.size)
        for k in range(work.size):
            work[k] = gain[k] * work[k] - target[k]
        _butterflies(work, blocks, work.size)
        return
    _butterflies(work, blocks, size)
    p, q, r, s = work[:size], work[size : 2 * size], work[2 * size : 3 * size], work[3 * size :]
    gain_p, gain_q, gain_r, gain_s = gain[:size], gain[size : 2 * size], gain[2 * size : 3 * size], gain[3 * size :]
    goal_p, goal_q, goal_r = target[:size], target[size : 2 * size], target[2 * size : 3 * size]
    goal_s = target[3 * size :]
    for k in range(size):
        a, b = p[k] + q[k], p[k] - q[k]
        c, d = r[k] + s[k], r[k] - s[k]
        e, f = gain_p[k] * (a + c) - goal_p[k], gain_q[k] * (b + d) - goal_q[k]
        g, h = gain_r[k] * (a - c) - goal_r[k], gain_s[k] * (b - d) - goal_s[k]
        a, b = e + f, e - f
        c, d = g + h, g - h
        p[k], q[k], r[k], s[k] = a + c, b + d, a - c, b - d
    _butterflies(work, blocks, size)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _butterflies(work: Flat, first: int, last: int) -> None:
    """Run the levels with distances `first`, 2 · `first`, … , `last` / 2 between paired values, up to three a pass."""
    half = first
    while 8 * half <= last:
        for start in range(0, work.size, 8 * half):
            _three_levels(work[start : start + 8 * half], half)
        half *= 8
    if 4 * half <= last:
        for start in range(0, work.size, 4 * half):
            _two_levels(work[start : start + 4 * half], half)
        half *= 4
    if 2 * half <= last:
        for start in range(0, work.size, 2 * half):
            p, q = work[start : start + half], work[start + half : start + 2 * half]
            for k in range(half):
                p[k], q[k] = p[k] + q[k], p[k] - q[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _three_levels(work: Flat, half: int) -> None:
    p, q, r, s = work[:half], work[half : 2 * half], work[2 * half : 3 * half], work[3 * half : 4 * half]
    t, u, v, w = work[4 * half : 5 * half], work[5 * half : 6 * half], work[6 * half : 7 * half], work[7 * half :]
    for k in range(half):
        a, b = p[k] + q[k], p[k] - q[k]
        c, d = r[k] + s[k], r[k] - s[k]
        a, b, c, d = a + c, b + d, a - c, b - d
        e, f = t[k] + u[k], t[k] - u[k]
        g, h = v[k] + w[k], v[k] - w[k]
        e, f, g, h = e + g, f + h, e - g, f - h
        p[k], q[k], r[k], s[k] = a + e, b + f, c + g, d + h
        t[k], u[k], v[k], w[k] = a - e, b - f, c - g, d - h


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _two_levels(work: Flat, half: int) -> None:
    p, q, r, s = work[:half], work[half : 2 * half], work[2 * half : 3 * half], work[3 * half :]
    for k in range(half):
        a, b = p[k] + q[k], p[k] - q[k]
        c, d = r[k] + s[k], r[k] - s[k]
        p[k], q[k], r[k], s[k] = a + c, b + d, a - c, b - d
