"""The newest sums of every block, or their means: a block whose frame is lost keeps its last sums for a few cycles."""

from typing import Final

import numpy as np
import numpy.typing as npt

from skin.layout import Layout
from skin.measurement import Sbhe

#: A missing block keeps its last sums for this number of cycles, or half of those that are averaged; after that it is
#: left out.
HOLD_CYCLES: Final = 4
#: Where nodes do not average, the classifier does, over cycles of about so much time.
AVERAGED_S: Final = 0.04


def averaged_cycles(layout: Layout) -> int:
    """Return over how many cycles the classifier averages sums: 1 where nodes average, and where rates change."""
    if layout.sending == "adaptive" or layout.samples_per_sync > 1 or layout.recognition is not None:
        return 1
    return max(1, round(AVERAGED_S * layout.sync.rate_hz))


class NewestSums:
    """The newest sums of every block, a few cycles old at most, or their means.

    Parameters
    ----------
    phi : Sbhe
    cycles : int
        More than one: means with exponential weights, whose noise is that of means of so many cycles. A block counts
        when so many of its sums have come, at the beginning and after it was left out.

    Attributes
    ----------
    sums : array of float64, shape (m,)
    valid : array of float32, shape (blocks,)
        1 if the newest sums are not too old and enough sums came.
    """

    def __init__(self, phi: Sbhe, cycles: int = 1) -> None:
        self.sums = np.zeros(phi.shape[0])
        self.valid = np.ones(phi.blocks, np.float32)
        self._cycles = cycles
        self._hold = max(HOLD_CYCLES, cycles // 2)
        self._work = np.zeros(phi.shape[0])
        #: Cycles since the newest sums of each block, and how many of its sums are in the mean, up to `cycles`.
        self._age = np.full(phi.blocks, self._hold, np.int32)
        self._count = np.zeros(phi.blocks, np.int32)
        self._came = np.ones(phi.blocks, np.bool_)
        self._came_sums = np.ones(phi.shape[0], np.bool_)
        self._block_of_sum = np.ascontiguousarray(phi.block_of_sum)
        self._sending = np.flatnonzero(phi.has_sums)

    def forget(self) -> None:
        """Drop all sums."""
        self._age.fill(self._hold)
        self._count.fill(0)

    def take(self, sums: npt.NDArray[np.int32], valid: npt.NDArray[np.bool_], step: int) -> float:
        """Take new sums, `step` cycles after the last; return the fraction in use of the blocks that send sums."""
        np.not_equal(valid, 0, out=self._came)
        self._count += self._came
        np.minimum(self._count, self._cycles, out=self._count)
        np.take(self._came, self._block_of_sum, out=self._came_sums, mode="clip")
        np.copyto(self._work, sums)
        if self._cycles > 1:
            # The mean of all at first; then with exponential weights.
            weight = np.maximum(2 / (self._cycles + 1), 1 / np.maximum(self._count, 1))
            self._work -= self.sums
            self._work *= weight[self._block_of_sum]
            self._work += self.sums
        np.copyto(self.sums, self._work, where=self._came_sums)
        self._age += max(1, min(step, self._hold))
        np.minimum(self._age, self._hold + 1, out=self._age)
        np.copyto(self._age, 0, where=self._came)
        np.copyto(self._count, 0, where=self._age > self._hold)
        np.greater_equal(self._count, self._cycles, out=self.valid, casting="unsafe")
        return float(self.valid[self._sending].mean())

    def valid_sums(self) -> npt.NDArray[np.bool_]:
        """Return which sums are in use, shape (m,); the array is reused."""
        np.not_equal(self.valid, 0, out=self._came)
        np.take(self._came, self._block_of_sum, out=self._came_sums, mode="clip")
        return self._came_sums
