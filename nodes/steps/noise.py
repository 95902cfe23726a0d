"""What a node learns of its own noise while nothing touches its patch.

`nodes/firmware/c/steps/skin_noise.c` is the same for real boards. `power_up` of the vectors of `skin contract` guards
both (`nodes.steps.vectors`).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dbc.patch_filter import LEAST_NOISE_N, SPANS, UNCLIP_REACH, Floats, unclip_table
from nodes.steps.transforms import to_haar
from shell.compiled import njit
from skin.clipping import IDLE_DEVIATION
from skin.walsh import patch_shape


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of the patches of some nodes.

    Attributes
    ----------
    offset_n : array of float32, shape (nodes, taxels)
        What an idle taxel reads, clipping undone, newtons.
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

    def noise(self) -> Noise:
        """Return what was learned, of at least twice the longest of `SPANS`."""
        mean = self._sum / self._count
        deviation = np.sqrt(np.maximum(self._square / self._count - mean**2, 0))
        taxel_n = np.maximum(deviation / IDLE_DEVIATION, LEAST_NOISE_N).astype(np.float32)
        offset_n = mean.astype(np.float32)
        unclip(offset_n.ravel(), taxel_n.ravel(), unclip_table())
        variance = np.zeros_like(mean)
        for place, span in enumerate(SPANS):
            count = self._count // span
            of_means = self._mean_squares[place] / count - (self._means[place] / count) ** 2
            variance = np.maximum(variance, span * of_means)
        coefficient_n = np.maximum(np.sqrt(variance) / IDLE_DEVIATION, LEAST_NOISE_N)
        return Noise(offset_n, taxel_n, coefficient_n.astype(np.float32))


@njit(cache=True, nogil=True, error_model="numpy")
def unclip(force_n: Floats, noise_n: Floats, table: Floats) -> None:
    """Undo the bias of clipping at 0 in place."""
    scale, last = np.float32((table.size - 1) / UNCLIP_REACH), np.float32(table.size - 1)
    for k in range(force_n.size):
        reading = force_n[k] / noise_n[k]
        place = max(np.float32(0), min(reading * scale, last))
        low = np.int32(min(place, last - np.float32(1)))
        part = place - np.float32(low)
        unclipped = table[low] + part * (table[low + 1] - table[low])
        force_n[k] = noise_n[k] * (unclipped if reading * scale < last else reading)
