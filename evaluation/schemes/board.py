"""The board of every scheme: the same samples of every taxel, the same idle seconds, and filters to choose from."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import isqrt
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from dbc.patch_filter import HORIZON, SETTLING_SAMPLES
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SIDE, Touch, counts_of
from evaluation.schemes.wire import patches
from nodes.averaging import SampleFilter
from nodes.steps.filtering import ForceFilter
from nodes.steps.noise import IdleStatistics, Noise
from skin.clipping import IDLE_DEVIATION
from skin.taxel import FORCE_MAX_N
from touch.coarse_arrays import averaged
from touch.contact import Force

Counts = npt.NDArray[np.int16]
Cells = npt.NDArray[np.int64]
#: What a board makes of its samples: ``raw``, one sample; ``averaged``, the averages of the default skin's boards;
#: ``patches``, the forecast of stepped boards.
FilterName = Literal["raw", "averaged", "patches"]
_Filter = TypeVar("_Filter", bound=ForceFilter)


@dataclass(frozen=True, eq=False)
class Board:
    """All that a scheme knows of a touch: what the boards of an array read.

    Attributes
    ----------
    counts, idle : arrays of int16, shape (ticks, cells)
        What every cell reads each millisecond, and what it read before, while nothing touched: boards learn their noise
        from that.
    """

    counts: Counts
    idle: Counts

    @property
    def side(self) -> int:
        """Cells of a side of the array."""
        return isqrt(self.counts.shape[1])

    def filtered(self, name: FilterName, horizon: float = HORIZON) -> tuple[Force, float]:
        """Return what a filter makes of every sample, and the median noise of a cell before the filter, newtons.

        Forces have the shape of `counts`. Filters of stepped boards forecast `horizon` samples ahead.
        """
        return _filtered(self, name, horizon)


@lru_cache(maxsize=1)
def board_of(touch: Touch, side: int = SIDE) -> Board:
    """Return the board of a touch, of the skin or of a coarse array: the one place where schemes get samples from."""
    what = touch.load()
    counts = what.counts
    if side != SIDE:
        fine = what.true_n.reshape(-1, SIDE, SIDE)
        coarse = averaged(fine, side).reshape(len(fine), -1)
        counts = counts_of(touch.sensed(coarse, np.random.default_rng(touch.seed + 1)))
    return Board(counts, touch.idle(side * side))


@lru_cache(maxsize=2)
def _filtered(board: Board, name: FilterName, horizon: float) -> tuple[Force, float]:
    if name == "raw":
        return newtons(board.counts), float(newtons(board.idle).std()) / IDLE_DEVIATION
    held = patches(board.side)
    cells = held.reshape(-1, held.shape[2])
    force_n = np.empty(board.counts.shape, np.float32)
    if name == "averaged":
        average = SampleFilter(cells)
        average.take(board.idle.astype(np.float32))
        for tick, sample in enumerate(board.counts):
            average.take(sample[None].astype(np.float32))
            force_n[tick] = average.counts * np.float32(NEWTON_PER_COUNT)
        noise_n = float(np.median(average.noise)) * NEWTON_PER_COUNT
    else:
        forecast = settled(lambda noise: ForceFilter(noise, horizon=horizon), board.idle, cells)
        for tick, sample in enumerate(board.counts):
            forecast.take(newtons(sample[cells]))
            force_n[tick, cells] = forecast.force_n
        noise_n = float(np.median(forecast.noise.node_n))
    return np.clip(force_n, 0, np.float32(FORCE_MAX_N)), noise_n


def settled(make: Callable[[Noise], _Filter], idle: Counts, cells: Cells) -> _Filter:
    """Return the filter of boards that have learned their noise from `idle`; `cells` of shape (nodes, cells)."""
    statistics = IdleStatistics(*cells.shape)
    for sample in idle:
        statistics.take(newtons(sample[cells]))
    made = make(statistics.noise())
    for sample in idle[-SETTLING_SAMPLES:]:
        made.take(newtons(sample[cells]))
    return made


def newtons(counts: npt.NDArray[np.integer]) -> Force:
    """Return counts of the converters as forces, float32."""
    return counts.astype(np.float32) * np.float32(NEWTON_PER_COUNT)
