"""The nodes' taxel readings: the sensor signal in ADC counts, the calibration of each node, and test patterns."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from skin.layout import Taxels
from skin.taxel import NOISE_N, TaxelModel, to_counts

#: Test patterns (2021h): measured counts; 0; the place in the chain; full scale.
PATTERN_OFF, PATTERN_ZERO, PATTERN_RAMP, PATTERN_FULL = range(4)


class Electronics:
    """The analogue side of a skin.

    Parameters
    ----------
    taxels : Taxels
        Range and resolution.
    noise_n : float
        Standard deviation of the sensor noise in newtons.
    seed : int
        Same seed, same noise.
    defects : mapping
        Defects of the taxels, as `skin.defects.parse_defects` returns them.
    period_s : float
        Time between two steps of the touch; drift and damper need it.

    Attributes
    ----------
    gain, offset : array of float32, shape (n,)
        Correction per taxel: ``gain * counts + offset``, in counts.
    taxels : Taxels
        As given.
    """

    def __init__(
        self,
        taxels: Taxels,
        *,
        noise_n: float = NOISE_N,
        seed: int = 0,
        defects: Mapping[str, Any] | None = None,
        period_s: float = 0.01,
    ) -> None:
        self.taxels = taxels
        self.gain = np.ones(taxels.count, np.float32)
        self.offset = np.zeros(taxels.count, np.float32)
        self._model = TaxelModel(noise_n, taxels.force_max_n, **(defects or {}))
        self._random = np.random.Generator(np.random.SFC64(seed))
        self._period_s = period_s
        self._last: tuple[int, npt.NDArray[np.float32]] | None = None
        self._pattern = np.full(taxels.count, -1, np.int32)

    def read(self, force_n: npt.NDArray[np.float32], step: int = 0) -> npt.NDArray[np.int32]:
        """Return corrected ADC counts, shape (n,), of true forces, shape (rows, columns), at `step`."""
        signal = self._model.signal_of_moments(
            self._with_damper(force_n, step)[None], self._random, np.array([step * self._period_s])
        )
        counts = to_counts(signal.ravel(), self.taxels)
        corrected = counts.astype(np.float32)
        with np.errstate(over="ignore"):  # an SDO write may set a huge gain; the result is clipped
            corrected *= self.gain
        corrected += self.offset
        np.rint(corrected, out=corrected)
        np.clip(corrected, 0, self.taxels.count_max, out=corrected)
        np.copyto(counts, corrected, casting="unsafe")
        np.copyto(counts, self._pattern, where=self._pattern >= 0)
        return counts

    def _with_damper(self, force_n: npt.NDArray[np.float32], step: int) -> npt.NDArray[np.float32]:
        """Return the force plus the damper's force; the speed is the mean since the last step that was read."""
        if self._model.damper is None:
            return force_n
        last_step, last_n = self._last or (step, force_n)
        self._last = step, force_n
        if step <= last_step:
            return force_n
        damped = self._model.damper(np.stack([last_n, force_n]), (step - last_step) * self._period_s)
        pressed: npt.NDArray[np.float32] = damped[1]
        return pressed

    def set_pattern(self, chain: npt.NDArray[np.intp], pattern: int) -> None:
        """Set the test pattern of one block; `chain` holds its taxels in chain order."""
        if pattern == PATTERN_RAMP:
            self._pattern[chain] = np.arange(chain.size)
        else:
            self._pattern[chain] = {PATTERN_ZERO: 0, PATTERN_FULL: self.taxels.count_max}.get(pattern, -1)
