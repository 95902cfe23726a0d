"""What a running node goes on learning: offsets that drift, and the size of its noise.

Both are learned where nothing touches. A force that grows more slowly than `RATE_N` a sample cannot be told from a
drift.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from nodes.adaptive.noise import Floats
from skin.clipping import IDLE_DEVIATION
from skin.compiled import njit

#: An offset follows this part of what is left in each sample, at most by so much, newtons: 3 mN a second.
FOLLOWING: Final = 1 / 128
RATE_N: Final = 3e-6
#: An offset is followed while the taxel and its neighbours in the patch show less than this part of their noise.
QUIET_RATIO: Final = 0.6
#: An offset that falls so far below 0, in units of the noise, is not followed further: nothing is left to be read.
LOWEST_RATIO: Final = -1.5
#: Samples between two notes of the offsets. When a touch begins, what was followed since the last note but one is given
#: back, because it may have been the touch.
NOTE_SAMPLES: Final = 128
#: Samples over which the size of the noise is looked at, and how far it is believed: the part by which its logarithm
#: moves.
WINDOW: Final = 256
BELIEF: Final = 0.25
#: Noise that is clipped at 0 has a mean of 0.68 standard deviations, whatever its size; a taxel outside of these bounds
#: is touched, or has an offset. The deviation is that of samples from the ones before, so that a touch that comes and
#: goes is no noise; nor is coloured noise, of whose size nothing more is learned.
IDLE_RATIOS: Final = (0.5, 0.9)
#: Part of a node's taxels that have to be idle.
IDLE_PART: Final = 0.5


class Offsets:
    """Offsets of the taxels of some nodes, which follow drifts.

    Parameters
    ----------
    nodes, high, wide : int
        The nodes, and height and width of each one's patch.
    """

    def __init__(self, nodes: int, high: int, wide: int) -> None:
        shape = (nodes, high, wide)
        self._offset, self._noted, self._older = np.zeros((3, *shape), np.float32)
        self._is_quiet, self._was_followed = np.ones((2, *shape), np.bool_)
        self._samples = 0

    def take(self, force_n: Floats, noise_n: Floats) -> None:
        """Take the offsets from the forces of one sample, in place, and follow them.

        Parameters
        ----------
        force_n, noise_n : arrays of float32, shape (nodes, high · wide)
            Forces, below 0 too; standard deviation of each taxel's noise.
        """
        shape = self._offset.shape
        forces = force_n.reshape(shape)
        forces -= self._offset
        self._samples += 1
        state = (self._offset, self._noted, self._older)
        _follow(forces, noise_n.reshape(shape), state, self._is_quiet, self._was_followed)
        if self._samples % NOTE_SAMPLES == 0:
            self._older[:] = self._noted
            self._noted[:] = self._offset


@njit(cache=True, nogil=True)
def _follow(
    force_n: npt.NDArray[np.float32],
    noise_n: npt.NDArray[np.float32],
    state: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]],
    is_quiet: npt.NDArray[np.bool_],
    was_followed: npt.NDArray[np.bool_],
) -> None:
    """Follow the offsets where a taxel and its neighbours are quiet; where a touch begins, give back what was new."""
    offset, noted, older = state
    nodes, high, wide = force_n.shape
    rate, part = np.float32(RATE_N), np.float32(FOLLOWING)
    rows_quiet = np.empty(wide, np.bool_)
    for node in range(nodes):
        for row in range(high):
            for column in range(wide):
                bound = np.float32(QUIET_RATIO) * noise_n[node, row, column]
                is_quiet[node, row, column] = force_n[node, row, column] < bound
        for row in range(high):
            above, below = max(row - 1, 0), min(row + 1, high - 1)
            for column in range(wide):
                rows_quiet[column] = (
                    is_quiet[node, above, column] & is_quiet[node, row, column] & is_quiet[node, below, column]
                )
            for column in range(wide):
                follows = rows_quiet[max(column - 1, 0)] & rows_quiet[column] & rows_quiet[min(column + 1, wide - 1)]
                if follows:
                    change = min(rate, max(-rate, part * force_n[node, row, column]))
                    lowest = np.float32(LOWEST_RATIO) * noise_n[node, row, column]
                    offset[node, row, column] = max(lowest, offset[node, row, column] + change)
                elif was_followed[node, row, column]:
                    offset[node, row, column] = older[node, row, column]
                    noted[node, row, column] = older[node, row, column]
                was_followed[node, row, column] = follows


class NoiseScale:
    """Looks at raw samples, and says by how much the noise of each node is larger than it is taken to be.

    Parameters
    ----------
    nodes, taxels : int
    """

    def __init__(self, nodes: int, taxels: int) -> None:
        self._sum, self._square = np.zeros((2, nodes, taxels))
        self._last_n = np.zeros((nodes, taxels), np.float32)
        self._samples = 0

    def take(self, sample_n: Floats, noise_n: Floats) -> Floats | None:
        """Take a sample, newtons; return by what to multiply the noise of each node, shape (nodes, 1), or None.

        Parameters
        ----------
        sample_n, noise_n : arrays of float32, shape (nodes, taxels)
        """
        _gather(sample_n.ravel(), self._last_n.ravel(), self._sum.ravel(), self._square.ravel())
        self._samples += 1
        if self._samples < WINDOW:
            return None
        mean = self._sum / WINDOW
        deviation = np.sqrt(self._square / (2 * WINDOW))
        idle = (deviation > 0) & (mean > IDLE_RATIOS[0] * deviation) & (mean < IDLE_RATIOS[1] * deviation)
        ratio = np.where(idle, deviation / (IDLE_DEVIATION * noise_n), np.nan)
        enough = idle.mean(axis=1) >= IDLE_PART
        scale = np.ones((len(mean), 1), np.float32)
        if enough.any():
            scale[enough, 0] = np.nanmedian(ratio[enough], axis=1) ** BELIEF
        self._sum[:] = self._square[:] = self._samples = 0
        return scale


@njit(cache=True, nogil=True)
def _gather(sample_n: Floats, last_n: Floats, total: npt.NDArray[np.float64], square: npt.NDArray[np.float64]) -> None:
    """Add samples, and the squares of their differences from the last samples."""
    for c in range(sample_n.size):
        change = sample_n[c] - last_n[c]
        square[c] += change * change
        total[c] += sample_n[c]
        last_n[c] = sample_n[c]
