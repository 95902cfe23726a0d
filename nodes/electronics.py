"""What the taxel electronics make of a force: noise, clipping, and an ADC."""

import numpy as np
import numpy.typing as npt

from skin.layout import Taxels


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
    """

    def __init__(self, taxels: Taxels, *, noise_n: float = 0.001, seed: int = 0) -> None:
        self._taxels = taxels
        self._noise_n = np.float32(noise_n)
        self._random = np.random.Generator(np.random.SFC64(seed))

    def read(self, force_n: npt.NDArray[np.float32]) -> npt.NDArray[np.int16]:
        """Return ADC counts, shape (n,): the force plus noise, clipped to the range, rounded to a count."""
        felt = force_n.ravel()
        if self._noise_n:
            felt = felt + self._noise_n * self._random.standard_normal(felt.size, np.float32)
        top = 2**self._taxels.adc_bits - 1
        counts = np.rint(felt * np.float32(1 / self._taxels.newton_per_count))
        # A layout keeps the ADC below 16 bits, so that sums fit the bus.
        clipped: npt.NDArray[np.int16] = np.clip(counts, 0, top).astype(np.int16)
        return clipped

    def newtons(self, counts: npt.NDArray[np.integer]) -> npt.NDArray[np.float32]:
        """Return the force that `counts` stand for."""
        return counts.astype(np.float32) * np.float32(self._taxels.newton_per_count)
