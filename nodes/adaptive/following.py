"""What a running node goes on learning: offsets that drift, and the size of its noise.

Both are learned where nothing touches. A force that grows more slowly than `RATE_N` a sample cannot be told from a
drift.
"""

from typing import Final, NamedTuple

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


class OffsetState(NamedTuple):
    """Offsets of some taxels, arrays of float32, shape (nodes, high, wide).

    Attributes
    ----------
    offset, noted, older : the offset now, at the newest note, and at the note before
    was_followed : array of bool
        Whether the offset was followed in the newest sample.
    """

    offset: Floats
    noted: Floats
    older: Floats
    was_followed: npt.NDArray[np.bool_]


class Offsets:
    """Offsets of the taxels of some nodes, which follow drifts.

    Parameters
    ----------
    nodes, high, wide : int
        The nodes, and height and width of each one's patch.

    Attributes
    ----------
    state : OffsetState
    """

    def __init__(self, nodes: int, high: int, wide: int) -> None:
        shape = (nodes, high, wide)
        offset, noted, older = np.zeros((3, *shape), np.float32)
        self.state = OffsetState(offset, noted, older, np.ones(shape, np.bool_))
        self._samples = 0

    def take(self, force_n: Floats, noise_n: Floats) -> None:
        """Take the offsets from the forces of one sample, in place, and follow them.

        Parameters
        ----------
        force_n, noise_n : arrays of float32, shape (nodes, high · wide)
            Forces, below 0 too; standard deviation of each taxel's noise.
        """
        shape = self.state.offset.shape
        follow(force_n.reshape(shape), noise_n.reshape(shape), self.state)
        self.note()

    def note(self) -> None:
        """Count a sample, and note the offsets when it is time."""
        self._samples += 1
        if self._samples % NOTE_SAMPLES == 0:
            self.state.older[:] = self.state.noted
            self.state.noted[:] = self.state.offset


@njit(cache=True, nogil=True, error_model="numpy")
def follow(force_n: Floats, noise_n: Floats, state: OffsetState) -> None:
    """Take the offsets from the forces, in place; follow them where a taxel and its neighbours are quiet.

    Where a touch begins, what was new is given back. Arrays have the shape of the state.
    """
    nodes = force_n.shape[0]
    size = force_n[0].size
    offset, noise = state.offset.reshape(nodes, size), noise_n.reshape(nodes, size)
    force, followed = force_n.reshape(nodes, size), state.was_followed.reshape(nodes, size)
    rate, part, lowest = np.float32(RATE_N), np.float32(FOLLOWING), np.float32(LOWEST_RATIO)
    for node in range(nodes):
        loud = np.float32(0)
        for c in range(size):
            left = force[node, c] - offset[node, c]
            force[node, c] = left
            loud += np.float32(1) if left >= np.float32(QUIET_RATIO) * noise[node, c] else np.float32(0)
        if loud > 0:
            _follow_some(force_n[node], noise_n[node], node, state)
            continue
        for c in range(size):
            change = min(rate, max(-rate, part * force[node, c]))
            offset[node, c] = max(lowest * noise[node, c], offset[node, c] + change)
            followed[node, c] = True


@njit(cache=True, nogil=True, error_model="numpy")
def _follow_some(force_n: Floats, noise_n: Floats, node: int, state: OffsetState) -> None:
    """Follow the offsets of a node some of whose taxels are not quiet; arrays of shape (high, wide)."""
    high, wide = force_n.shape
    rate, part = np.float32(RATE_N), np.float32(FOLLOWING)
    is_quiet, rows_quiet = np.empty((high, wide), np.bool_), np.empty(wide, np.bool_)
    offset, noted, older = state.offset[node], state.noted[node], state.older[node]
    was_followed = state.was_followed[node]
    for row in range(high):
        for column in range(wide):
            is_quiet[row, column] = force_n[row, column] < np.float32(QUIET_RATIO) * noise_n[row, column]
    for row in range(high):
        above, below = max(row - 1, 0), min(row + 1, high - 1)
        for column in range(wide):
            rows_quiet[column] = is_quiet[above, column] & is_quiet[row, column] & is_quiet[below, column]
        for column in range(wide):
            follows = rows_quiet[max(column - 1, 0)] & rows_quiet[column] & rows_quiet[min(column + 1, wide - 1)]
            if follows:
                change = min(rate, max(-rate, part * force_n[row, column]))
                lowest = np.float32(LOWEST_RATIO) * noise_n[row, column]
                offset[row, column] = max(lowest, offset[row, column] + change)
            elif was_followed[row, column]:
                offset[row, column] = noted[row, column] = older[row, column]
            was_followed[row, column] = follows


class ScaleSums(NamedTuple):
    """Sums over the samples of some taxels, arrays of float32, shape (nodes, taxels).

    Attributes
    ----------
    total, square : sums of the samples, and of the squares of their differences from the samples before
    last_n : newest samples, newtons
    """

    total: Floats
    square: Floats
    last_n: Floats


class NoiseScale:
    """Looks at raw samples, and says by how much the noise of each node is larger than it is taken to be.

    Parameters
    ----------
    nodes, taxels : int

    Attributes
    ----------
    sums : ScaleSums
    """

    def __init__(self, nodes: int, taxels: int) -> None:
        self.sums = ScaleSums(*np.zeros((3, nodes, taxels), np.float32))
        self._samples = 0

    def take(self, sample_n: Floats, noise_n: Floats) -> Floats | None:
        """Take a sample, newtons; return by what to multiply the noise of each node, shape (nodes, 1), or None.

        Parameters
        ----------
        sample_n, noise_n : arrays of float32, shape (nodes, taxels)
        """
        gather(sample_n, self.sums)
        return self.judge(noise_n)

    def judge(self, noise_n: Floats) -> Floats | None:
        """Count a sample that `sums` has taken, and return what `take` does."""
        self._samples += 1
        if self._samples < WINDOW:
            return None
        mean = self.sums.total / WINDOW
        deviation = np.sqrt(self.sums.square / (2 * WINDOW))
        idle = (deviation > 0) & (mean > IDLE_RATIOS[0] * deviation) & (mean < IDLE_RATIOS[1] * deviation)
        ratio = np.where(idle, deviation / (IDLE_DEVIATION * noise_n), np.nan)
        enough = idle.mean(axis=1) >= IDLE_PART
        scale = np.ones((len(mean), 1), np.float32)
        if enough.any():
            scale[enough, 0] = np.nanmedian(ratio[enough], axis=1) ** BELIEF
        self.sums.total[:] = self.sums.square[:] = self._samples = 0
        return scale


@njit(cache=True, nogil=True)
def gather(sample_n: Floats, sums: ScaleSums) -> None:
    """Add samples, and the squares of their differences from the last samples; shape (nodes, taxels)."""
    sample = sample_n.ravel()
    total, square, last = sums.total.ravel(), sums.square.ravel(), sums.last_n.ravel()
    for c in range(sample.size):
        change = sample[c] - last[c]
        square[c] += change * change
        total[c] += sample[c]
        last[c] = sample[c]
