"""What a running node goes on learning: offsets that drift, and the size of its noise.

Both are learned where nothing touches. A force that grows more slowly than `RATE_N` a sample cannot be told from a
drift.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.adaptive_filter import (
    FOLLOWING,
    IDLE_PART,
    IDLE_RATIOS,
    LOWEST_RATIO,
    NOTE_SAMPLES,
    QUIET_RATIO,
    RATE_N,
    WINDOW,
    Floats,
)
from skin.clipping import IDLE_DEVIATION
from skin.compiled import njit


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
        scale = np.ones((len(noise_n), 1), np.float32)
        _judge(self.sums, noise_n, scale)
        self.sums.total[:] = self.sums.square[:] = self._samples = 0
        return scale


@njit(cache=True, nogil=True, error_model="numpy")
def _judge(sums: ScaleSums, noise_n: Floats, scale: Floats) -> None:
    """Write by what to multiply the noise of each node, shape (nodes, 1): fourth root of the median of idle taxels."""
    nodes, size = noise_n.shape
    lowest, highest = np.float32(IDLE_RATIOS[0]), np.float32(IDLE_RATIOS[1])
    samples, idle_deviation, half = np.float32(WINDOW), np.float32(IDLE_DEVIATION), np.float32(0.5)
    ratios = np.empty(size, np.float32)
    for node in range(nodes):
        idle = 0
        for c in range(size):
            mean = sums.total[node, c] / samples
            deviation = np.sqrt(sums.square[node, c] / (samples + samples))
            if deviation > 0 and lowest * deviation < mean < highest * deviation:
                ratios[idle] = deviation / (idle_deviation * noise_n[node, c])
                idle += 1
        if idle == 0 or idle < IDLE_PART * size:
            continue
        ratios[:idle].sort()
        median = ratios[idle // 2]
        if idle % 2 == 0:
            median = (ratios[idle // 2 - 1] + median) * half
        scale[node, 0] = np.sqrt(np.sqrt(median))


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
