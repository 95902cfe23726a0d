"""Sums that did not come, estimated from those that did.

Sums of one touch vary together: a few directions explain nearly all of their variance. Under y = mean + F z + noise,
z and noise independent, the expectation of the missing sums given the others is mean + F ẑ, where
(FᵥᵀFᵥ + ψ I) ẑ = Fᵥᵀ(yᵥ - meanᵥ) over the valid sums v.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]

#: Directions kept: more gain nothing on the paper's 16 objects, from 64 to 1024 sums.
MOST_FACTORS: Final = 16


class Factors(NamedTuple):
    """How the sums of known touches vary together.

    Attributes
    ----------
    mean : array, shape (m,)
    loadings : array, shape (m, factors)
        F.
    noise : float
        ψ, the variance that is left in each sum.
    """

    mean: Float64
    loadings: Float64
    noise: float


def fit_factors(sums: Float64) -> Factors:
    """Return the factors of `sums`, shape (count, m): the largest principal components.

    Raises
    ------
    ValueError
        If there are fewer than 2 observations.
    """
    if len(sums) < 2:
        raise ValueError(f"expected 2 or more observations, got {len(sums)}")
    mean = sums.mean(axis=0)
    _, singular, directions = np.linalg.svd(sums - mean, full_matrices=False)
    variances = singular**2 / (len(sums) - 1)
    kept = min(MOST_FACTORS, max(1, sums.shape[1] // 2), variances.size)
    left = float(variances[kept:].sum()) / max(1, sums.shape[1] - kept)
    noise = max(left, 1e-9 * float(variances.sum()), np.finfo(float).tiny)
    return Factors(mean, np.ascontiguousarray((directions[:kept] * np.sqrt(variances[:kept, None])).T), noise)


class Completion:
    """Fills in missing sums, without allocation.

    Parameters
    ----------
    factors : Factors
    """

    def __init__(self, factors: Factors) -> None:
        self._factors = tuple(factors)
        count = factors.loadings.shape[1]
        self._gram = np.zeros((count, count))
        self._scores = np.zeros(count)

    def complete(self, sums: Float64, valid: npt.NDArray[np.bool_]) -> None:
        """Overwrite the sums that are not valid, both of shape (m,), with their expectation."""
        _normal_equations(sums, valid, self._factors, self._gram, self._scores)
        _solved(self._gram, self._scores)
        _filled(sums, valid, self._factors, self._scores)


def _normal(
    sums: Float64, valid: npt.NDArray[np.bool_], factors: tuple[Float64, Float64, float], gram: Float64, scores: Float64
) -> None:
    """Fill `gram`, its lower triangle, and `scores` with both sides of the equation of ẑ."""
    mean, loadings, noise = factors
    count = scores.size
    gram[:] = 0.0
    scores[:] = 0.0
    for i in range(count):
        gram[i, i] = noise
    for index in range(sums.size):
        if valid[index]:
            for i in range(count):
                scores[i] += loadings[index, i] * (sums[index] - mean[index])
                for j in range(i + 1):
                    gram[i, j] += loadings[index, i] * loadings[index, j]


def _solve(gram: Float64, scores: Float64) -> None:
    """Replace `scores` by the solution: Cholesky in place, then forward and back substitution."""
    count = scores.size
    for i in range(count):
        for j in range(i):
            for k in range(j):
                gram[i, j] -= gram[i, k] * gram[j, k]
            gram[i, j] /= gram[j, j]
            gram[i, i] -= gram[i, j] ** 2
            scores[i] -= gram[i, j] * scores[j]
        gram[i, i] = math.sqrt(gram[i, i])
        scores[i] /= gram[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            scores[i] -= gram[k, i] * scores[k]
        scores[i] /= gram[i, i]


def _fill(
    sums: Float64, valid: npt.NDArray[np.bool_], factors: tuple[Float64, Float64, float], scores: Float64
) -> None:
    mean, loadings, _ = factors
    for index in range(sums.size):
        if not valid[index]:
            sums[index] = mean[index]
            for i in range(scores.size):
                sums[index] += loadings[index, i] * scores[i]


_normal_equations: Callable[..., None] = numba.njit(cache=True)(_normal)
_solved: Callable[..., None] = numba.njit(cache=True)(_solve)
_filled: Callable[..., None] = numba.njit(cache=True)(_fill)
