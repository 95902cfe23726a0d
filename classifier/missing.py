"""Estimates of missing sums from the other sums.

A few factors explain nearly all of the variance of the sums. With y = mean + F z + noise, z and noise independent, the
expectation of the missing sums given the other sums is mean + F ẑ, where
(FᵥᵀFᵥ + ψ I) ẑ = Fᵥᵀ(yᵥ - meanᵥ) over the valid sums v.
"""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]

#: Most factors: more factors bring no gain for the paper's 16 objects, from 64 to 1024 sums.
MOST_FACTORS: Final = 16


class Factors(NamedTuple):
    """Factors of the sums of trained touches.

    Attributes
    ----------
    mean : array, shape (m,)
    loadings : array, shape (m, factors)
        F.
    noise : float
        ψ, the variance of each sum that the factors do not explain.
    """

    mean: Float64
    loadings: Float64
    noise: float


#: Of a model whose features are no sums.
NO_FACTORS: Final = Factors(np.zeros(0), np.zeros((0, 0)), 0.0)


def fit_factors(sums: Float64) -> Factors:
    """Return the factors of `sums`, shape (count, m), 2 observations or more: the largest principal components."""
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
    """Estimates missing sums."""

    def __init__(self, factors: Factors) -> None:
        sums, count = factors.loadings.shape
        self._factors = factors
        self._noise = factors.noise * np.eye(count)
        # Deviations of the valid sums, zero elsewhere; the array is reused in every measurement.
        self._loadings = np.zeros((sums, count))
        self._gram = np.zeros((count, count))
        self._sums = np.zeros(sums)

    def complete(self, sums: Float64, valid: npt.NDArray[np.bool_]) -> None:
        """Replace the sums that are not valid by their expectation; both arrays of shape (m,)."""
        mean, loadings, _ = self._factors
        self._loadings.fill(0.0)
        np.copyto(self._loadings, loadings, where=valid[:, None])
        np.matmul(self._loadings.T, self._loadings, out=self._gram)
        self._gram += self._noise
        np.subtract(sums, mean, out=self._sums)
        scores = np.linalg.solve(self._gram, self._sums @ self._loadings)
        np.matmul(loadings, scores, out=self._sums)
        self._sums += mean
        np.copyto(sums, self._sums, where=~valid)
