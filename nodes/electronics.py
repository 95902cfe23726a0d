"""What the taxel electronics make of a force: noise, clipping, an ADC, and the node's calibration."""

from typing import Final

import numpy as np
import numpy.typing as npt

from skin.layout import Taxels

#: Test patterns (2021h): measure, nothing, one count more from place to place, full scale.
PATTERN_OFF, PATTERN_ZERO, PATTERN_RAMP, PATTERN_FULL = range(4)


class Electronics:
    """The analogue side of a skin.

    Parameters
    ----------
    taxels : Taxels
        Range and resolution.
    noise_n : float
        Standard deviation of the sensor noise in newtons; the paper uses 0.001.
    seed : int
        Same seed, same noise.

    Attributes
    ----------
    gain, offset : array of float32, shape (n,)
        Correction per taxel: ``gain * counts + offset``, in counts.
    top : int
        Largest count.
    """

    def __init__(self, taxels: Taxels, *, noise_n: float = 0.001, seed: int = 0) -> None:
        self.gain = np.ones(taxels.count, np.float32)
        self.offset = np.zeros(taxels.count, np.float32)
        self.top: Final = (1 << taxels.adc_bits) - 1
        self._newton_per_count = np.float32(taxels.newton_per_count)
        self._noise_n = np.float32(noise_n)
        self._random = np.random.Generator(np.random.SFC64(seed))
        self._pattern = np.full(taxels.count, -1, np.int32)

    def read(self, force_n: npt.NDArray[np.float32]) -> npt.NDArray[np.int32]:
        """Return corrected ADC counts, shape (n,): noise added, clipped to the range, rounded to a count."""
        felt = force_n.ravel()
        if self._noise_n:
            felt = felt + self._noise_n * self._random.standard_normal(felt.size, np.float32)
        counts = np.clip(np.rint(felt / self._newton_per_count), 0, self.top)
        corrected = np.clip(np.rint(self.gain * counts + self.offset), 0, self.top)
        shown: npt.NDArray[np.int32] = np.where(self._pattern >= 0, self._pattern, corrected).astype(np.int32)
        return shown

    def newtons(self, counts: npt.NDArray[np.integer]) -> npt.NDArray[np.float32]:
        """Return the force that `counts` stand for."""
        return counts.astype(np.float32) * self._newton_per_count

    def set_pattern(self, chain: npt.NDArray[np.intp], pattern: int) -> None:
        """Let the taxels of one block, in the order of their chain, show a test pattern."""
        if pattern == PATTERN_RAMP:
            self._pattern[chain] = np.arange(chain.size)
        else:
            self._pattern[chain] = {PATTERN_ZERO: 0, PATTERN_FULL: self.top}.get(pattern, -1)
