"""What a node learns of its own noise while nothing touches its patch."""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.clipping import IDLE_DEVIATION, IDLE_MEAN
from skin.walsh import patch_shape

#: Noise is looked at in means of so many samples, so that coloured and common noise show.
SPANS: Final = (1, 4, 16)
#: No noise is taken to be smaller, newtons: one count of the default skin.
LEAST_NOISE_N: Final = 0.02e-3
#: An idle taxel that reads more than clipped noise explains, by this ratio and so many counts, has an offset.
OFFSET_RATIO: Final = 1.6
OFFSET_COUNTS: Final = 3

Floats = npt.NDArray[np.float32]


@cache
def haar_matrix(taxels: int) -> Floats:
    """Return the orthonormal Haar pyramid of a patch, coarse rows first, shape (taxels, taxels).

    A patch that is twice as wide as high is first halved across; every square is then quartered, down to taxels.
    """
    high, wide = patch_shape(taxels)
    rows = [np.ones((high, wide))]
    if wide > high:
        rows.append(np.ones((high, wide)))
        rows[-1][:, high:] = -1
    size = high
    while size > 1:
        half = size // 2
        signs = np.ones(size)
        signs[half:] = -1
        for shape in (np.outer(signs, np.ones(size)), np.outer(np.ones(size), signs), np.outer(signs, signs)):
            for down in range(0, high, size):
                for across in range(0, wide, size):
                    row = np.zeros((high, wide))
                    row[down : down + size, across : across + size] = shape
                    rows.append(row)
        size = half
    flat = np.stack([row.ravel() / np.linalg.norm(row) for row in rows])
    return flat.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of the patches of some nodes.

    Attributes
    ----------
    offset_n : array of float32, shape (nodes, taxels)
        What an idle taxel reads besides clipped noise, newtons.
    taxel_n : array of float32, shape (nodes, taxels)
        Standard deviation of each taxel's noise before clipping, newtons.
    coefficient_n : array of float32, shape (nodes, taxels)
        The same of each Haar coefficient, as its slowest noise would need it.
    """

    offset_n: Floats
    taxel_n: Floats
    coefficient_n: Floats

    @property
    def node_n(self) -> npt.NDArray[np.float64]:
        """Root mean square of each node's coefficients, newtons, shape (nodes,)."""
        square = np.square(self.coefficient_n, dtype=np.float64)
        return np.asarray(np.sqrt(square.mean(axis=1)), np.float64)


class IdleStatistics:
    """Sums over the samples of an idle skin, from which `noise` is found; each sample is seen once and not kept.

    Parameters
    ----------
    nodes, taxels : int
        Taxels of each node's patch.
    """

    def __init__(self, nodes: int, taxels: int) -> None:
        self._haar = haar_matrix(taxels)
        self._count = 0
        self._sum, self._square = np.zeros((2, nodes, taxels))
        self._partial = np.zeros((len(SPANS), nodes, taxels))
        self._means, self._mean_squares = np.zeros((2, len(SPANS), nodes, taxels))

    @property
    def count(self) -> int:
        """Samples taken."""
        return self._count

    def take(self, sample_n: Floats) -> None:
        """Take one sample of every taxel, shape (nodes, taxels), newtons."""
        self._count += 1
        self._sum += sample_n
        self._square += np.square(sample_n, dtype=np.float64)
        coefficients = sample_n @ self._haar.T
        for place, span in enumerate(SPANS):
            partial = self._partial[place]
            partial += coefficients
            if self._count % span == 0:
                partial /= span
                self._means[place] += partial
                self._mean_squares[place] += np.square(partial)
                partial[:] = 0

    def noise(self, newton_per_count: float) -> Noise:
        """Return what was learned, of at least twice the longest of `SPANS`."""
        mean = self._sum / self._count
        deviation = np.sqrt(np.maximum(self._square / self._count - mean**2, 0))
        taxel_n = np.maximum(deviation / IDLE_DEVIATION, LEAST_NOISE_N)
        explained_n = OFFSET_RATIO * IDLE_MEAN * taxel_n + OFFSET_COUNTS * newton_per_count
        offset_n = np.where(mean > explained_n, mean, 0.0)
        variance = np.zeros_like(mean)
        for place, span in enumerate(SPANS):
            count = self._count // span
            of_means = self._mean_squares[place] / count - (self._means[place] / count) ** 2
            variance = np.maximum(variance, span * of_means)
        coefficient_n = np.maximum(np.sqrt(variance) / IDLE_DEVIATION, LEAST_NOISE_N)
        return Noise(*(each.astype(np.float32) for each in (offset_n, taxel_n, coefficient_n)))
