"""The sub-sampled separable noiselet, the paper's second measurement ensemble (section V).

Φ = Q (N_R ⊗ N_C): every sum is a ±1 combination of all taxels, which no block of a distributed skin can form by
itself. It is here to be compared with SBHE, not to be sent over a bus.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from reconstructor.array_api import Ensemble
from skin.measurement import seeded
from skin.operator import check_vectors

Pairs = tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]


def fast_noiselet(values: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
    """Multiply the last axis by the real noiselet matrix N of ±1, in n log2 n additions.

    A real form of the dragon noiselets of Coifman, Geshwind and Meyer (2001): N is symmetric and N N = n I. Integers
    stay exact where their dtype holds n times the largest value.

    Parameters
    ----------
    values : array, shape (..., n)
        n a power of two of at least 2.
    """
    work: npt.NDArray[Any] = np.array(values)
    (first, last), *others = butterflies(values.shape[-1])
    a, b = work[..., first], work[..., last]
    work[..., first], work[..., last] = a + b, a - b
    for first, last in others:
        a, b = work[..., first], work[..., last]
        work[..., first], work[..., last] = a - b, a + b
    return work


@cache
def butterflies(size: int) -> list[Pairs]:
    """Return which places are paired in each of the log2(size) steps of N; the first adds where the others subtract."""
    first = np.arange(size // 2)
    top = size - 1
    steps = [(first, top - first)]
    distance = top >> 1
    while distance:
        steps.append((first, first ^ top ^ distance))
        distance >>= 1
    return steps


@dataclass(frozen=True, eq=False)
class Noiselet:
    """Φ = Q (N_R ⊗ N_C), shape (m, n), entries ±1, rows orthogonal: Φ Φᵀ = n I.

    Attributes
    ----------
    rows, columns : int
        The grid of taxels, powers of two.
    kept : array of int, shape (m,)
        Selection Q: the products u · columns + v of rows u of N_R and v of N_C that are sent, ascending.
    """

    rows: int
    columns: int
    kept: npt.NDArray[np.intp]

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n): sums and taxels."""
        return self.kept.size, self.rows * self.columns

    @property
    def norm_squared(self) -> float:
        """Largest eigenvalue of ΦᵀΦ: n, for every kept row alike."""
        return float(self.shape[1])

    def forward(self, x: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return y = Φ x, shape (..., m), of taxels (..., n); integers are summed exactly in int64."""
        check_vectors("taxels", x, self.shape[1])
        return self._transform(_summable(x))[..., self.kept]

    def adjoint(self, y: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return Φᵀ y, shape (..., n), of sums (..., m)."""
        check_vectors("sums", y, self.shape[0])
        work = _summable(y)
        spread = np.zeros((*y.shape[:-1], self.shape[1]), work.dtype)
        spread[..., self.kept] = work
        return self._transform(spread)  # both matrices are symmetric

    def ensemble(self) -> Ensemble:
        """Return the matrices of the noiselet, for `reconstructor.array_api.BatchSolver`."""
        down, across = (np.asarray(fast_noiselet(np.eye(size))) for size in (self.rows, self.columns))
        return Ensemble(np.arange(self.shape[1]), down, across, self.kept, self.norm_squared)

    def _transform(self, taxels: npt.NDArray[Any]) -> npt.NDArray[Any]:
        along_rows = fast_noiselet(taxels.reshape(*taxels.shape[:-1], self.rows, self.columns))
        both = fast_noiselet(along_rows.swapaxes(-1, -2)).swapaxes(-1, -2)
        return both.reshape(taxels.shape)


def noiselet(rows: int, columns: int, sums: int, *, seed: int = 1) -> Noiselet:
    """Draw a sub-sampled noiselet: `sums` of the rows · columns products, seeded; the sides are powers of two."""
    random = seeded(seed)
    return Noiselet(rows, columns, np.sort(random.permutation(rows * columns)[:sums]).astype(np.intp))


def _summable(values: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
    return values if np.issubdtype(values.dtype, np.floating) else values.astype(np.int64)
