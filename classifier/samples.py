"""Features for training: simulated sums of true forces, and the features of these sums."""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from classifier.features import Float32, widths_for
from classifier.model import Float64
from classifier.newest_sums import averaged_cycles
from classifier.observer import Observer
from classifier.used_sums import noise_ratios, silence
from skin.clipping import DEAD_RATIO, clipped_mean
from skin.frontend import converter
from skin.layout import Layout
from skin.phi import Phi
from skin.taxel import sense, to_counts

#: Part of the cycles of an untouched skin that are above the threshold of contact.
FALSE_ALARM_RATIO: Final = 0.002
#: Training includes missing blocks and lower noise: blocks are missing in every third touch, every second touch has
#: less noise.
_LOSS_EVERY: Final = 3
_QUIET_EVERY: Final = 2
MOST_LOST_RATIO: Final = 0.3
_CHUNK: Final = 128


class Untouched(NamedTuple):
    """Untouched skin: ``no_touch`` as in `classifier.model.Model`, and the threshold of contact."""

    no_touch: Float64
    contact_threshold: float


class Observations(NamedTuple):
    """Observations as `classifier.newest_sums` has them, and the conditions of each.

    Attributes
    ----------
    sums : array of int32 or float32, shape (count, m)
    valid : array of float32, shape (count, blocks)
    noise_ratio : array, shape (count,)
    cycle : array of int, shape (count,)
        From 1.
    """

    sums: npt.NDArray[Any]
    valid: npt.NDArray[np.float32]
    noise_ratio: Float64
    cycle: npt.NDArray[np.int64]

    def part(self, rows: npt.NDArray[np.intp]) -> "Observations":
        """Return some of the observations."""
        return Observations(self.sums[rows], self.valid[rows], self.noise_ratio[rows], self.cycle[rows])

    @staticmethod
    def of_whole(sums: npt.NDArray[Any], phi: Phi) -> "Observations":
        """Return observations of cycles in order from 1, without missing blocks."""
        count = len(sums)
        whole = np.broadcast_to(np.float32(1), (count, phi.blocks))
        return Observations(sums, whole, np.ones(count), np.arange(1, count + 1))


def simulate_sums(
    force_n: Float32, layout: Layout, phi: Phi, noise_n: float | Float64, rng: np.random.Generator
) -> npt.NDArray[np.int32]:
    """Return simulated sums of true forces: noise, clipping, ADC, then Φ in counts.

    With an analogue front end: Φ, the noise of the taxels without clipping, then the converters of the sums.

    Parameters
    ----------
    force_n : array of float32, shape (count, n) or (count, rows, columns)
        True forces in newtons.
    noise_n : float or array, shape (count,)
        Standard deviation of the noise of each observation; boards leave a part of it (`classifier.used_sums`).

    Returns
    -------
    array of int32, shape (count, m)
        Where Φ changes from frame to frame, the k-th observation, from 0, is of cycle k + 1.
    """
    taxels = layout.taxels
    flat = force_n.reshape(len(force_n), -1)
    least, most = noise_ratios(layout)
    left = rng.uniform(least, most, len(flat)) if least < most else np.full(len(flat), most)
    own_n = np.broadcast_to(np.asarray(noise_n, np.float32), (len(flat),))
    sd = own_n * left.astype(np.float32)
    of_sums, root = converter(layout), np.float32(layout.measurement.block_size**0.5)
    sums = np.empty((len(flat), phi.shape[0]), np.int32)
    for start in range(0, len(flat), _CHUNK):
        part = slice(start, start + _CHUNK)
        if of_sums is not None:
            sums_n = np.asarray(phi.forward(flat[part]), np.float32)
            sums_n += rng.standard_normal(sums_n.shape, np.float32) * sd[part, None] * root
            sums[part] = of_sums.counts(sums_n)
            continue
        signal_n = sense(flat[part], rng, sd[part, None], taxels.force_max_n)
        if not layout.sends.in_cycles:
            silence(signal_n, flat[part], own_n[part, None] * np.float32(DEAD_RATIO), layout.phi())
        counts = to_counts(signal_n, taxels)
        if phi.frames == 1:
            sums[part] = phi.forward(counts)
            continue
        for each, of_one in enumerate(counts, start):
            sums[each] = phi.of_cycle(each + 1).forward(of_one)
    return sums


def simulate_means(
    force_n: Float32, layout: Layout, phi: Phi, noise_n: float | Float64, rng: np.random.Generator
) -> npt.NDArray[np.int32]:
    """Return simulated sums as the classifier averages them; see `simulate_sums`.

    The noise is that of one cycle less what `averaged_cycles` leave; clipped noise keeps its mean. In turns a sum is in
    several of them.
    """
    sums, cycles = simulate_sums(force_n, layout, phi, noise_n, rng), averaged_cycles(layout) / layout.sync.turns
    if cycles <= 1:
        return sums
    expected = _expected_counts(force_n, layout, phi, noise_n)
    return np.rint(expected + (sums - expected) * np.float32(cycles**-0.5)).astype(np.int32)


def _expected_counts(force_n: Float32, layout: Layout, phi: Phi, noise_n: float | Float64) -> Float32:
    """Return the mean of the sums of boards that sample once a cycle, counts, shape (count, m)."""
    taxels = layout.taxels
    expected = np.empty((len(force_n), phi.shape[0]), np.float32)
    noises_n = np.broadcast_to(np.maximum(noise_n, taxels.newton_per_count / 100), (len(force_n),))
    for each, force, noise in zip(expected, force_n.reshape(len(force_n), -1), noises_n, strict=True):
        if taxels.is_analogue:
            mean_n = force
        else:
            mean_n = noise * (clipped_mean(force / noise) - clipped_mean((force - taxels.force_max_n) / noise))
        each[:] = phi.forward(np.asarray(mean_n / taxels.newton_per_count, np.float32))
    return expected


def observe_untouched(layout: Layout, phi: Phi, noise_n: float, count: int, rng: np.random.Generator) -> Untouched:
    """Measure `count` draws of the untouched skin.

    `FALSE_ALARM_RATIO` of the draws have a largest standardised peak above the threshold.
    """
    still = np.broadcast_to(np.float32(0), (count, layout.taxels.count))
    return standard_untouched(Observations.of_whole(simulate_means(still, layout, phi, noise_n, rng), phi), layout, phi)


def standard_untouched(still: Observations, layout: Layout, phi: Phi) -> Untouched:
    """Return what observations of the untouched skin show; see `observe_untouched`."""
    ignorant = np.ones((4, len(widths_for(layout.taxels.surface))))
    observer = Observer(phi, layout.taxels.surface, ignorant, means=not layout.sends.in_cycles)
    sending = np.flatnonzero(phi.has_sums)
    seen = np.empty((len(still.sums), 2, ignorant.shape[1]))
    for one, sums, valid, noise_ratio, cycle in zip(seen, *still, strict=True):
        observer.look(sums, valid, float(valid[sending].mean()), noise_ratio, cycle)
        one[:] = observer.smoothed.energies, observer.smoothed.peaks
    mean = seen.mean(axis=0)
    sd = np.maximum(seen.std(axis=0), np.finfo(np.float32).tiny)
    largest = ((seen[:, 1] - mean[1]) / sd[1]).max(axis=1)
    threshold = float(np.quantile(largest, 1 - FALSE_ALARM_RATIO))
    return Untouched(np.stack([mean[0], sd[0], mean[1], sd[1]]), threshold)


class FeatureExtractor:
    """Features of measurements, standardised by the untouched skin.

    Parameters
    ----------
    no_touch : array, shape (4, widths)
    recorded : Observations, optional
        Conditions of the observations, by their number; default: no block is missing, and cycles count from 1.
    """

    def __init__(self, layout: Layout, phi: Phi, no_touch: Float64, recorded: Observations | None = None) -> None:
        taxels, means = layout.taxels, not layout.sends.in_cycles
        self._observer = Observer(phi, taxels.surface, no_touch, means=means)
        self._recorded = recorded
        self._valid = np.ones(phi.blocks, np.float32)
        self._sending = np.flatnonzero(phi.has_sums)

    @property
    def blocks(self) -> int:
        """Number of blocks that send sums."""
        return self._sending.size

    def features(
        self,
        sums: npt.NDArray[Any],
        lost: npt.NDArray[np.intp],
        rng: np.random.Generator,
        which: npt.NDArray[np.intp] | None = None,
    ) -> Float64:
        """Return the features of `sums`, shape (count, 2 widths), with `lost` more missing blocks in each.

        `which` are the numbers of the observations among those of `simulate_sums`, or among the recorded; default: all,
        in order.
        """
        seen = np.empty((len(sums), self._observer.features.size))
        numbers, recorded = np.arange(len(sums)) if which is None else which, self._recorded
        for one, gone, made, number in zip(sums, lost, seen, numbers.tolist(), strict=True):
            noise_ratio, cycle = 1.0, number + 1
            self._valid.fill(1)
            if recorded is not None:
                noise_ratio, cycle = float(recorded.noise_ratio[number]), int(recorded.cycle[number])
                np.copyto(self._valid, recorded.valid[number])
            if gone:
                present = self._sending[self._valid[self._sending] != 0]
                self._valid[present[rng.permutation(present.size)[: min(gone, present.size - 1)]]] = 0
            self._observer.look(one, self._valid, float(self._valid[self._sending].mean()), noise_ratio, cycle)
            made[:] = self._observer.features
        return seen


def draw_noise_levels(count: int, noise_n: float, least: float, rng: np.random.Generator) -> Float64:
    """Return the noise of each of `count` touches, newtons: every second is `least` to 1 times `noise_n`."""
    deviations = np.full(count, noise_n)
    deviations[::_QUIET_EVERY] *= rng.uniform(least, 1, deviations[::_QUIET_EVERY].size)
    return deviations


def draw_missing_counts(count: int, blocks: int, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """Return the number of missing blocks of each touch: in every third up to `MOST_LOST_RATIO` of the blocks."""
    lost = np.zeros(count, np.intp)
    lost[::_LOSS_EVERY] = rng.integers(0, int(blocks * MOST_LOST_RATIO) + 1, lost[::_LOSS_EVERY].size)
    return lost
