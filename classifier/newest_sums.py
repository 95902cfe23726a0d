"""The newest sums of every block, or their means: a block whose frame is lost keeps its last sums for a few cycles."""

from typing import Final

import numpy as np
import numpy.typing as npt

from skin.measurement import Sbhe

#: A missing block keeps its last sums for this number of cycles; after that it is left out.
HOLD_CYCLES: Final = 4


class NewestSums:
    """The newest sums of every block, up to `HOLD_CYCLES` cycles old.

    Parameters
    ----------
    phi : Sbhe
    cycles : int
        More than one: means with exponential weights, whose noise is that of means of so many cycles. They begin as on
        an untouched skin, at 0; those of a block that was left out begin with its next sums.

    Attributes
    ----------
    sums : array of float64, shape (m,)
    valid : array of float32, shape (blocks,)
        1 if the sums are at most `HOLD_CYCLES` cycles old.
    """

    def __init__(self, phi: Sbhe, cycles: int = 1) -> None:
        self.sums = np.zeros(phi.shape[0])
        self._weight = 2 / (cycles + 1)
        self._newest = np.zeros(phi.shape[0])
        self.valid = np.ones(phi.blocks, np.float32)
        self._age = np.full(phi.blocks, HOLD_CYCLES, np.int32)
        self._came = np.ones(phi.blocks, np.bool_)
        self._came_sums = np.ones(phi.shape[0], np.bool_)
        self._block_of_sum = np.ascontiguousarray(phi.block_of_sum)
        self._sending = np.flatnonzero(phi.has_sums)

    def forget(self) -> None:
        """Drop all sums."""
        self.sums.fill(0)
        self._age.fill(HOLD_CYCLES)

    def take(self, sums: npt.NDArray[np.int32], valid: npt.NDArray[np.bool_], step: int) -> float:
        """Take new sums, `step` cycles after the last; return the fraction in use of the blocks that send sums."""
        np.not_equal(valid, 0, out=self._came)
        np.take(self._came, self._block_of_sum, out=self._came_sums, mode="clip")
        np.copyto(self._newest, sums)
        if self._weight < 1:
            self._newest -= self.sums
            self._newest *= np.where(self._age > HOLD_CYCLES, 1, self._weight)[self._block_of_sum]
            self._newest += self.sums
        np.copyto(self.sums, self._newest, where=self._came_sums)
        self._age += max(1, min(step, HOLD_CYCLES))
        np.minimum(self._age, HOLD_CYCLES + 1, out=self._age)
        np.copyto(self._age, 0, where=self._came)
        np.less_equal(self._age, HOLD_CYCLES, out=self.valid, casting="unsafe")
        return float(self.valid[self._sending].mean())

    def valid_sums(self) -> npt.NDArray[np.bool_]:
        """Return which sums are in use, shape (m,); the array is reused."""
        np.less_equal(self._age, HOLD_CYCLES, out=self._came)
        np.take(self._came, self._block_of_sum, out=self._came_sums, mode="clip")
        return self._came_sums
