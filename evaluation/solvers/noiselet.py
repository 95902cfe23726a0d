"""The sub-sampled separable noiselet, the paper's second measurement ensemble (section V).

Φ = Q (N_R ⊗ N_C): every sum is a ±1 combination of all taxels, which no block of a distributed skin can form by
itself. It is here to be compared with SBHE, not to be sent over a bus.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from skin.operator import check_vectors
from skin.phi import seeded


@cache
def noiselet_matrix(size: int, kind: str = "int64") -> npt.NDArray[Any]:
    """Return the real noiselet matrix N of ±1, shape (size, size), of a dtype; `size` a power of two of at least 2.

    A real form of the dragon noiselets of Coifman, Geshwind and Meyer (2001): N is symmetric and N N = n I. Each of
    log2(n) steps pairs rows; the first adds where the others subtract.
    """
    work = np.eye(size, dtype=kind)
    first, top = np.arange(size // 2), size - 1
    a, b = work[first], work[top - first]
    work[first], work[top - first] = a + b, a - b
    distance = top >> 1
    while distance:
        last = first ^ top ^ distance
        a, b = work[first], work[last]
        work[first], work[last] = a - b, a + b
        distance >>= 1
    return work


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
        return self._transform(spread)

    def _transform(self, taxels: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return N_R X N_C of taxels as a matrix X, of their dtype; both matrices are symmetric."""
        images = taxels.reshape(*taxels.shape[:-1], self.rows, self.columns)
        down, across = (noiselet_matrix(size, taxels.dtype.name) for size in (self.rows, self.columns))
        transformed: npt.NDArray[Any] = (down @ images @ across).reshape(taxels.shape)
        return transformed


def noiselet(rows: int, columns: int, sums: int, *, seed: int = 1) -> Noiselet:
    """Draw a sub-sampled noiselet: `sums` of the rows · columns products, seeded; the sides are powers of two."""
    random = seeded(seed)
    return Noiselet(rows, columns, np.sort(random.permutation(rows * columns)[:sums]).astype(np.intp))


def _summable(values: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
    return values if np.issubdtype(values.dtype, np.floating) else values.astype(np.int64)
