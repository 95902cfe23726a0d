"""The newest sums of every block, or their means: a block whose frame is lost keeps its last sums for a few cycles."""

from typing import Final

import numpy as np
import numpy.typing as npt

from skin.layout import Layout
from skin.phi import Phi

#: A missing block keeps its last sums, or their mean, for this number of cycles, or for half of those that are averaged
#: if these are more; after that it is left out.
HOLD_CYCLES: Final = 4
#: Variance of a mean of no sums, in place of infinity.
_UNKNOWN: Final = 1e30
#: Where nodes do not average, the classifier averages the cycles of about this time.
AVERAGED_S: Final = 0.04


#: After a gap of more cycles than this, or than three times those that are averaged if these are more, past cycles
#: count no more.
FORGET_CYCLES: Final = 10


def averaged_cycles(layout: Layout) -> int:
    """Return over how many cycles the classifier averages sums: 1 where nodes average, and where Φ changes."""
    if layout.samples_per_sync > 1 or len(layout.measurement.matrix or ()) > 1:
        return 1
    return max(1, round(AVERAGED_S * layout.sync.rate_hz))


class NewestSums:
    """The newest sums of every block, a few cycles old at most, or their means.

    Parameters
    ----------
    cycles : int
        More than one: exponentially weighted means, as quiet as plain means of `cycles` cycles. An old mean fades in
        cycles without sums, too.

    Attributes
    ----------
    sums : array of float64, shape (m,)
    valid : array of float32, shape (blocks,)
        1 if the newest sums are not too old.
    noise_ratio : float
        Noise of the sums in use / noise of means of `cycles`, root mean square. Above 1 at the beginning, and after
        many cycles without sums.
    """

    def __init__(self, phi: Phi, cycles: int = 1) -> None:
        self.sums = np.zeros(phi.shape[0])
        self.valid = np.ones(phi.blocks, np.float32)
        self.noise_ratio = 1.0
        self._cycles = cycles
        self._old_weight = 1 - 2 / (cycles + 1)
        #: Sums of another Φ are of no use.
        self._hold = max(HOLD_CYCLES, cycles // 2) if phi.frames == 1 else 0
        self._work = np.zeros(phi.shape[0])
        #: Cycles since the newest sums of each block, and the variance of its mean / that of one cycle's sums.
        self._age = np.zeros(phi.blocks, np.int64)
        self._variance = np.zeros(phi.blocks)
        self._came = np.ones(phi.blocks, np.bool_)
        self._came_sums = np.ones(phi.shape[0], np.bool_)
        self._block_of_sum = np.ascontiguousarray(phi.block_of_sum)
        self._sending = np.flatnonzero(phi.has_sums)
        self.forget()

    def forget(self) -> None:
        """Drop all sums."""
        self._age.fill(self._hold)
        self._variance.fill(_UNKNOWN)

    def is_gap(self, step: int) -> bool:
        """Tell whether sums, `step` cycles after the last, have nothing to do with them."""
        return not 0 < step <= max(FORGET_CYCLES, 3 * self._cycles)

    def take(self, sums: npt.NDArray[np.int32], valid: npt.NDArray[np.bool_], step: int) -> float:
        """Take new sums, `step` cycles after the last; return the fraction in use of the blocks that send sums.

        After a gap or a step back, past sums are dropped.
        """
        if self.is_gap(step):
            self.forget()
        np.not_equal(valid, 0, out=self._came)
        np.take(self._came, self._block_of_sum, out=self._came_sums, mode="clip")
        self._age += max(1, step)
        np.copyto(self._work, sums)
        if self._cycles > 1:
            self._average()
        np.copyto(self.sums, self._work, where=self._came_sums)
        np.copyto(self._age, 0, where=self._came)
        np.less_equal(self._age, self._hold, out=self.valid, casting="unsafe")
        used = self.valid[self._sending]
        valid_ratio = float(used.mean())
        if self._cycles > 1 and valid_ratio > 0:
            variance = float(self._variance[self._sending] @ used) / (valid_ratio * used.size)
            self.noise_ratio = max(1.0, (self._cycles * variance) ** 0.5)
        return valid_ratio

    def _average(self) -> None:
        """Turn the new sums in `_work` into means: of all at first, then with exponential weights."""
        variance = self._variance
        # An old mean weighs as little as if sums had come all the time, and less where its noise is larger.
        weight = np.maximum(1 - self._old_weight**self._age, variance / (variance + 1))
        np.copyto(variance, (1 - weight) ** 2 * variance + weight**2, where=self._came)
        self._work -= self.sums
        self._work *= weight[self._block_of_sum]
        self._work += self.sums

    def valid_sums(self) -> npt.NDArray[np.bool_]:
        """Return which sums are in use, shape (m,); the array is reused."""
        np.not_equal(self.valid, 0, out=self._came)
        np.take(self._came, self._block_of_sum, out=self._came_sums, mode="clip")
        return self._came_sums
