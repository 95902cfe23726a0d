"""What a running node goes on learning: offsets that drift, and the size of its noise.

Both are learned where nothing touches. No force is negative: so a zero that reads less is wrong, and is corrected at
once. What reads more is a touch, unless it grows more slowly than `RISE_N` a sample, or a zero comes back that fell.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.patch_filter import (
    FOLLOWING,
    HIGHEST_N,
    IDLE_PART,
    IDLE_RATIOS,
    LOWEST_RATIO,
    QUIET_RATIO,
    RATE_N,
    RETURN_N,
    RISE_N,
    WINDOW,
    Floats,
)
from shell.compiled import njit
from skin.clipping import IDLE_DEVIATION
from skin.walsh import patch_shape


class OffsetState(NamedTuple):
    """Offsets of some taxels, arrays of float32, shape (nodes, high, wide).

    Attributes
    ----------
    offset : the offset now
    idle : that of power-up
    stays : array of bool, shape (nodes,)
        Whether the offsets of a node are not followed.
    """

    offset: Floats
    idle: Floats
    stays: npt.NDArray[np.bool_]


def new_offsets(offset_n: Floats) -> OffsetState:
    """Return offsets that begin with those of power-up, newtons, shape (nodes, taxels)."""
    idle = offset_n.reshape(len(offset_n), *patch_shape(offset_n.shape[1]))
    return OffsetState(idle.copy(), idle, np.zeros(len(idle), np.bool_))


@njit(cache=True, nogil=True, error_model="numpy")
def follow(force_n: Floats, noise_n: Floats, state: OffsetState) -> None:
    """Take the offsets from the forces, in place; follow them where a taxel and its neighbours are quiet.

    Arrays have the shape of the state.
    """
    nodes, high, wide = force_n.shape
    is_quiet, rows_quiet = np.empty((high, wide), np.bool_), np.empty(wide, np.bool_)
    for node in range(nodes):
        loud = 0
        for row in range(high):
            for column in range(wide):
                left = force_n[node, row, column] - state.offset[node, row, column]
                force_n[node, row, column] = left
                is_quiet[row, column] = left < np.float32(QUIET_RATIO) * noise_n[node, row, column]
                loud += not is_quiet[row, column]
        if state.stays[node]:
            continue
        for row in range(high):
            above, below = max(row - 1, 0), min(row + 1, high - 1)
            for column in range(wide):
                rows_quiet[column] = is_quiet[above, column] & is_quiet[row, column] & is_quiet[below, column]
            for column in range(wide):
                before, after = max(column - 1, 0), min(column + 1, wide - 1)
                if loud == 0 or rows_quiet[before] & rows_quiet[column] & rows_quiet[after]:
                    _follow_one(force_n[node, row, column], noise_n[node, row, column], (node, row, column), state)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _follow_one(left: Any, noise: Any, place: tuple[int, int, int], state: OffsetState) -> None:
    """Follow the offset of a taxel that shows `left`."""
    offset, idle = state.offset[place], state.idle[place]
    most = np.float32(RETURN_N) if offset < idle else np.float32(RISE_N)
    change = min(most, max(np.float32(-RATE_N), np.float32(FOLLOWING) * left))
    highest = idle + np.float32(HIGHEST_N)
    state.offset[place] = max(np.float32(LOWEST_RATIO) * noise, min(highest, offset + change))


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


def judged(sums: ScaleSums, noise_n: Floats, taxels: npt.NDArray[np.intp]) -> Floats:
    """Return by what to multiply the noise of each node after WINDOW samples, shape (nodes, 1); begin the sums anew.

    `taxels` are how many each node has, shape (nodes,): its other places are empty.
    """
    scale = np.ones((len(noise_n), 1), np.float32)
    _judge(sums, noise_n, taxels, scale)
    sums.total[:] = sums.square[:] = 0
    return scale


@njit(cache=True, nogil=True, error_model="numpy")
def _judge(sums: ScaleSums, noise_n: Floats, taxels: npt.NDArray[np.intp], scale: Floats) -> None:
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
        if idle == 0 or idle < IDLE_PART * taxels[node]:
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
