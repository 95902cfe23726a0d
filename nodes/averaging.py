"""What a node samples between two SYNCs, averaged taxel by taxel as far as motion allows.

Every taxel runs a few of the models of `dbc.patch_filter` on its samples. What the models need to know is learned
from the samples:

* The variance of a taxel's noise is the mean square of its second differences, over 6. A touch hardly adds to them, for
  a touch moves little from one sample to the next.
* A taxel that nothing touches, of a sensor that clips its noise N(0, σ²) at 0, reads 0.40 σ on average with a standard
  deviation of 0.58 σ. The ratio of the two is 0.68 whatever σ is, and larger under any force. So a node tells its idle
  taxels by this ratio and learns σ from them, also while other taxels are touched. With σ the node undoes the bias of
  clipping (`skin.clipping`). Until σ is known, and where noise is none, averages stay as they are.

`nodes/firmware/c/skin_average.c` is the same for real boards. No vector of `skin contract` covers averages;
`tests/nodes/firmware/test_averages.py` compares both.
"""

import numpy as np
import numpy.typing as npt

from dbc.averaging import (
    DEAD_RATIO,
    EVENNESS,
    IDLE_BAND,
    IDLE_PART,
    LEARNING_GAIN,
    MEMORY,
    OUTLIER_RATIO,
    ROUNDING,
    averaging_models,
)
from dbc.patch_filter import Floats, Models
from nodes.steps.models import Tracks, new_tracks, step
from shell.compiled import njit
from skin.clipping import IDLE_DEVIATION, IDLE_MEAN, ClipCorrection


class SampleFilter:
    """Averages of the samples of all taxels of some nodes.

    Parameters
    ----------
    blocks : array of int, shape (blocks, block size)
        Taxels of each block; every block learns a σ of its own.
    places : int, optional
        Number of taxels n, those of no block included.

    Attributes
    ----------
    counts : array of float32, shape (n,)
        Averages at the newest sample, in counts, without the bias of clipping.
    noise : array of float32, shape (blocks,)
        σ of each block in counts; 0 while unknown.
    """

    def __init__(self, blocks: npt.NDArray[np.intp], places: int | None = None) -> None:
        taxels = places or blocks.size
        self.counts = np.zeros(taxels, np.float32)
        self.noise = np.zeros(len(blocks), np.float32)
        self._blocks = blocks
        self._models = averaging_models()
        self._tracks = new_tracks(self._models, taxels)
        self._age = np.zeros(taxels, np.int32)
        self._last, self._difference = np.zeros((2, taxels), np.float32), np.zeros((2, taxels), np.float32)
        self._scale = np.ones(taxels, np.float32)
        self._average, self._variance = np.zeros(taxels, np.float32), np.zeros(taxels, np.float32)
        self._unclipped = ClipCorrection(1.0)

    def restart(self, block: int) -> None:
        """Forget what the taxels of a block have read, and their noise."""
        taxels = self._blocks[block]
        self._age[taxels] = 0
        self.noise[block] = 0
        self.counts[taxels] = self._last[0, taxels]

    def take(self, samples: Floats) -> None:
        """Take in consecutive samples of every taxel, counts, shape (samples, n)."""
        _learn(samples, self._age, self._last, self._difference)
        noise = self._of_taxels(self.noise)
        scale = self._deviation(noise)
        _average(samples, self._age, self._models, self._tracks, scale, self._scale, self._average, self._variance)
        self._scale = scale
        self._learn_noise()
        self.counts = self._without_bias(self._of_taxels(self.noise))

    def _of_taxels(self, of_blocks: Floats) -> Floats:
        spread = np.zeros(self._age.size, np.float32)
        spread[self._blocks] = of_blocks[:, None]
        return spread

    def _deviation(self, noise: Floats) -> Floats:
        """Return the deviation of each taxel's noise before clipping, which makes it smaller where nothing touches."""
        seen = np.sqrt(np.maximum(self._difference[0] / 6, np.float32(ROUNDING)))
        deviation: Floats = np.where(noise > 0, np.maximum(noise, seen), seen / np.float32(IDLE_DEVIATION))
        return deviation

    def _learn_noise(self) -> None:
        square, size = self._difference
        clean = np.maximum(square / 6 - np.float32(ROUNDING), 0)
        expected = np.sqrt(clean) * np.float32(IDLE_MEAN / IDLE_DEVIATION)
        idle = np.abs(self._average - expected) < IDLE_BAND * expected
        idle &= (size * size > EVENNESS * square) & (self._age >= MEMORY)
        by_block = idle[self._blocks]
        count = by_block.sum(axis=1)
        learns = count >= IDLE_PART * self._blocks.shape[1]
        # The median: a few noisy taxels are idle, too.
        ordered = np.sort(np.where(by_block, clean[self._blocks], np.inf)[learns], axis=1)
        halves = np.stack(((count[learns] - 1) // 2, count[learns] // 2), axis=1)
        middle = np.take_along_axis(ordered, halves, axis=1).mean(axis=1)
        found, known = np.sqrt(middle) / np.float32(IDLE_DEVIATION), self.noise[learns]
        self.noise[learns] = np.where(known > 0, known + np.float32(LEARNING_GAIN) * (found - known), found)

    def _without_bias(self, noise: Floats) -> Floats:
        known = noise > 0
        unit: Floats = np.where(known, noise, np.float32(1))
        force = self._unclipped(self._average / unit) * unit
        force[force < np.float32(DEAD_RATIO) * np.sqrt(self._variance) * self._scale] = 0
        return np.where(known, force, self._average)


@njit(cache=True, nogil=True)
def _learn(samples: Floats, age: npt.NDArray[np.int32], last: Floats, difference: Floats) -> None:
    """Follow the mean of the squares and of the sizes of second differences; `last` holds the two newest samples."""
    square, size = difference[0], difference[1]
    least = np.float32(6 * ROUNDING)
    for each in samples:
        for c in range(each.size):
            if age[c] == 0:
                square[c] = size[c] = 0
            elif age[c] > 1:
                found = abs(each[c] - np.float32(2) * last[0, c] + last[1, c])
                gain = np.float32(1 / MEMORY)
                if age[c] <= MEMORY:
                    gain = np.float32(1) / np.float32(age[c] - 1)
                else:
                    found = min(found, np.sqrt(np.float32(OUTLIER_RATIO) * max(square[c], least)))
                square[c] += gain * (found * found - square[c])
                size[c] += gain * (found - size[c])
            last[1, c] = last[0, c]
            last[0, c] = each[c]
            age[c] = min(age[c] + 1, 2 * MEMORY)


@njit(cache=True, nogil=True)
def _average(  # noqa: PLR0917  compiled functions take no keywords
    samples: Floats,
    age: npt.NDArray[np.int32],
    models: Models,
    tracks: Tracks,
    scale: Floats,
    last_scale: Floats,
    average: Floats,
    variance: Floats,
) -> None:
    """Run the models on samples in units of `scale`; the tracks are in units of `last_scale` and are scaled anew."""
    count = tracks.level.shape[0]
    for model in range(count):
        level, slope, weight = tracks.level[model], tracks.slope[model], tracks.weight[model]
        for c in range(scale.size):
            if age[c] <= samples.shape[0]:  # begins with these samples
                level[c] = samples[0, c] / scale[c]
                slope[c] = 0
                weight[c] = np.float32(1) / np.float32(count)
            else:
                ratio = last_scale[c] / scale[c]
                level[c] *= ratio
                slope[c] *= ratio
    scaled = np.empty_like(scale)
    for each in samples:
        for c in range(scaled.size):
            scaled[c] = each[c] / scale[c]
        step(scaled, models, tracks, np.float32(0), average, variance)
    for c in range(average.size):
        average[c] *= scale[c]
