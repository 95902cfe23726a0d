"""What a node learns of its own noise while nothing touches its patch."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dbc.adaptive_filter import LEAST_NOISE_N, OFFSET_COUNTS, OFFSET_RATIO, SPANS, Floats
from nodes.adaptive.transforms import to_haar
from skin.clipping import IDLE_DEVIATION, IDLE_MEAN
from skin.compiled import njit
from skin.walsh import patch_shape


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
        node_n: npt.NDArray[np.float64] = _root_mean_squares(self.coefficient_n)
        return node_n


@njit(cache=True, nogil=True)
def _root_mean_squares(value: Floats) -> npt.NDArray[np.float64]:
    """Return the root mean square of each row; the squares are added in their order."""
    found = np.zeros(value.shape[0])
    for row in range(value.shape[0]):
        for place in range(value.shape[1]):
            found[row] += np.float64(value[row, place]) * np.float64(value[row, place])
        found[row] = np.sqrt(found[row] / value.shape[1])
    return found


class IdleStatistics:
    """Sums over the samples of an idle skin, from which `noise` is found; each sample is seen once and not kept.

    Parameters
    ----------
    nodes, taxels : int
        Taxels of each node's patch.
    """

    def __init__(self, nodes: int, taxels: int) -> None:
        self._patch = patch_shape(taxels)
        self._count = 0
        self._sum, self._square = np.zeros((2, nodes, taxels))
        self._coefficients = np.zeros((nodes, taxels), np.float32)
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
        to_haar(np.array(sample_n, np.float32), *self._patch, self._coefficients)
        for place, span in enumerate(SPANS):
            partial = self._partial[place]
            partial += self._coefficients
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
