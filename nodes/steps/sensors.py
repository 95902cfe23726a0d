"""The taxels of stepped boards: every board samples its own patch by its own clock, a thousand times a second.

The touch comes in steps of 10 ms. Between two steps the force is interpolated to the instant of each board's sample.
A board's clock has its own phase, runs up to `DRIFT_PPM` too fast or too slow, and jitters. All boards of a process are
sampled in one pass, so here a board whose clock has gained or lost a whole sample takes up the count of the others: it
leaves out a sample, or repeats one. A real board would not.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dbc.patch_filter import SAMPLE_NS, Floats
from nodes.electronics import Calibration
from shell.compiled import njit
from skin.sources import Frame, TaxelSource
from skin.taxel import Memory, TaxelModel
from skin.ways_of_sending import STEPPED_STEP_HZ

#: Time between two steps of the touch.
STEP_NS: Final = round(1e9 / STEPPED_STEP_HZ)
STEP_S: Final = STEP_NS * 1e-9
#: Largest error of a board's clock, and standard deviation of its jitter, samples.
DRIFT_PPM: Final = 100.0
JITTER: Final = 0.02

#: Number of equally likely values of noise, which end at 4.2 standard deviations: 16 random bits for each.
_VALUES: Final = 1 << 16
#: Steps of the touch that are kept.
_STEPS_KEPT: Final = 8

Doubles = npt.NDArray[np.float64]


class PatchSensors:
    """The taxels of some boards.

    Parameters
    ----------
    calibration : Calibration
        Of the whole skin.
    cells : array of int, shape (boards, taxels)
        Row-major places of each board's taxels.
    source : TaxelSource
        Steps of 10 ms. The skin is untouched until `touch_from_ns` is set.
    seed : int
        Of noise and clocks.

    Attributes
    ----------
    counts : array of float32, shape (boards, taxels)
        What every taxel read last, corrected, whole ADC counts.
    shows_pattern : array of bool, shape (boards,)
        Whether that was a test pattern.
    touch_from_ns : int or None
        When step 0 of the touch is.
    is_stale : bool
        Whether gains, offsets and test patterns have changed: the next sample reads them anew.
    """

    def __init__(
        self,
        calibration: Calibration,
        cells: npt.NDArray[np.intp],
        model: TaxelModel,
        source: TaxelSource,
        seed: int,
    ) -> None:
        from scipy.special import ndtri  # no verb waits for SciPy that has no need of it

        taxels = calibration.taxels
        self.counts = np.zeros(cells.shape, np.float32)
        self.touch_from_ns: int | None = None
        self._calibration, self._cells, self._model = calibration, cells, model
        #: Return the touch at a step. Two intervals and the truth need each step.
        self.frame: Callable[[int], Frame] = lru_cache(maxsize=_STEPS_KEPT)(source.frame)
        self._shape = taxels.rows, taxels.columns
        self._random = np.random.Generator(np.random.SFC64(seed))
        self._normal = ndtri((np.arange(_VALUES) + 0.5) / _VALUES).astype(np.float32)
        self._noise_n = self._of_taxels(model.noise_of(self._shape))
        fixed_n = model.fixed_n(self._shape)
        self._fixed_n = self._of_taxels(np.nan if fixed_n is None else fixed_n)
        self._range = np.array([taxels.force_max_n, taxels.newton_per_count, taxels.count_max], np.float32)
        # How long ago, in samples, each board's newest sample was at a tick, and by how much that grows in a sample.
        self._age = self._random.uniform(0, 1, len(cells))
        self._drift = self._random.uniform(-DRIFT_PPM, DRIFT_PPM, len(cells)) * 1e-6
        # Forces at both ends of the intervals from step `_step` on and of the next: shape (2, 2, boards, taxels).
        self._step: int | None = None
        # What defects keep of the forces until the newest interval begins, and its step.
        self._memory: Memory = {}
        self._memory_step: int | None = None
        self._ends_n = np.zeros((2, 2, *cells.shape), np.float32)
        self._ends_n[:] = self._of_taxels(model.felt_n(np.zeros((1, *self._shape), np.float32), np.zeros(1))[0])
        self._stops = [(stop.start_s, np.isin(cells, stop.taxels)) for stop in model.defects.stops]
        self._recalibrate()

    def _recalibrate(self) -> None:
        cells, calibration = self._cells, self._calibration
        self._gain, self._offset = calibration.gain[cells], calibration.offset[cells]
        self._pattern = calibration.pattern[cells].astype(np.float32)
        self.shows_pattern = (self._pattern >= 0).any(axis=1)
        self.is_stale = False

    def drifted_n(self, tick_ns: int) -> Floats:
        """Return how far the zeros of the taxels have drifted by place, newtons, shape (rows, columns)."""
        since_ns = 0 if self.touch_from_ns is None else max(0, tick_ns - self.touch_from_ns)
        return self._model.drifted_n(self._shape, since_ns * 1e-9)

    def sample(self, tick_ns: int) -> Floats:
        """Sample every taxel for a tick; the samples are up to 1 ms old then. Newtons, shape (boards, taxels)."""
        if self.is_stale:
            self._recalibrate()
        since = 0.0
        if self.touch_from_ns is not None:
            steps = (tick_ns - self.touch_from_ns) / STEP_NS
            # The oldest sample of the tick is 1 ms old, or a little more by its jitter.
            first = int((tick_ns - 2 * SAMPLE_NS - self.touch_from_ns) // STEP_NS)
            if first != self._step:
                self._load(first)
            since = steps - first
        sample_n = np.empty_like(self.counts)
        words = -(-(self.counts.size + len(self.counts)) // 4)
        drawn = self._random.bit_generator.random_raw(words).view(np.uint16)
        clocks, ends_n, taxels = (self._age, self._drift), self._ends_n, (self._noise_n, self._fixed_n, self._range)
        corrections, before = (self._gain, self._offset, self._pattern), self.counts.copy()
        _sample(since, drawn, self._normal, clocks, ends_n, taxels, corrections, self.counts, sample_n)
        for start_s, is_stopped in self._stops:
            if self.touch_from_ns is not None and tick_ns - self.touch_from_ns >= start_s * 1e9:
                np.copyto(self.counts, before, where=is_stopped)
                np.copyto(sample_n, before * self._range[1], where=is_stopped)
        return sample_n

    def _load(self, first: int) -> None:
        """Take the forces of the two intervals from step `first` on."""
        if self._step is not None and first == self._step + 1:
            self._ends_n[0] = self._ends_n[1]
            self._ends_n[1] = self._interval(first + 1)
        else:
            self._ends_n[0], self._ends_n[1] = self._interval(first), self._interval(first + 1)
        self._step = first

    def _interval(self, step: int) -> Floats:
        """Return the felt forces at both ends of an interval, shape (2, boards, taxels); before step 0 that of 0."""
        begin_n, end_n = (self.frame(max(0, each)).force_n for each in (step, step + 1))
        # The speed in the interval is even; a damper takes that since the moment before.
        moments_n = self._model.damped_n(np.stack([2 * begin_n - end_n, begin_n, end_n]), STEP_S)[1:]
        since_s = 0.0 if self._memory_step is None else max(0, step - self._memory_step) * STEP_S
        first_n, self._memory = self._model.remembered_n(moments_n[:1], self._memory, since_s)
        moments_n = np.concatenate([first_n, self._model.remembered_n(moments_n[1:], self._memory, STEP_S)[0]])
        self._memory_step = step
        time_s = STEP_S * np.maximum(0, np.array([step, step + 1], np.float64))
        return self._of_taxels(self._model.felt_n(moments_n, time_s))

    def _of_taxels(self, of_skin: Any) -> Floats:
        """Return values of the skin, shape (..., rows, columns) or one for all, by board; 0 at empty places."""
        skin = np.broadcast_to(of_skin, self._shape) if np.ndim(of_skin) == 0 else np.asarray(of_skin)
        *lead, rows, columns = skin.shape
        places = np.zeros((*lead, self._calibration.gain.size), np.float32)
        places[..., : rows * columns] = skin.reshape(*lead, -1)
        return np.take(places, self._cells, axis=-1)


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(  # noqa: PLR0917  compiled functions take no keywords
    since: float,
    drawn: npt.NDArray[np.uint16],
    normal: Floats,
    clocks: tuple[Doubles, Doubles],
    ends_n: Floats,
    taxels: tuple[Floats, Floats, Floats],
    corrections: tuple[Floats, Floats, Floats],
    counts: Floats,
    sample_n: Floats,
) -> None:
    """Move the clocks by a sample, and write what every taxel reads; `since` is the tick, in steps of the touch."""
    age, drift = clocks
    noise_n, fixed_n, limits = taxels
    gain, offset, pattern = corrections
    zero, one = np.float32(0), np.float32(1)
    force_max_n, newton_per_count, count_max = limits[0], limits[1], limits[2]
    boards, size = counts.shape
    noise = np.empty(size, np.float32)
    for board in range(boards):
        age[board] += drift[board]
        if age[board] >= 1:
            age[board] -= 1
        elif age[board] < 0:
            age[board] += 1
        late = age[board] + JITTER * normal[drawn[boards * size + board]]
        place = max(0.0, since - late * (SAMPLE_NS / STEP_NS))
        interval = min(1, int(place))
        part = np.float32(place - interval)
        begin_n, end_n = ends_n[interval, 0, board], ends_n[interval, 1, board]
        for c in range(size):
            noise[c] = normal[drawn[board * size + c]]
        for c in range(size):
            force = begin_n[c] + part * (end_n[c] - begin_n[c]) + noise_n[board, c] * noise[c]
            force = min(force_max_n, max(zero, force))
            force = fixed_n[board, c] if fixed_n[board, c] >= zero else force
            read = min(count_max, np.rint(force * (one / newton_per_count)))
            read = np.rint(min(count_max, max(zero, gain[board, c] * read + offset[board, c])))
            read = pattern[board, c] if pattern[board, c] >= zero else read
            counts[board, c] = read
            sample_n[board, c] = read * newton_per_count
