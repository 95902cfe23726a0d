"""The noise of the sums of a skin, and what clipping makes of it."""

from typing import Final

import numpy as np

from calibration.windows import Floats, Window
from skin.clipping import IDLE_MEAN
from skin.phi import Sbhe
from skin.taxel import NOISE_N

#: Noise of sums that are not averaged, in units of what the paper's sensor has: below, the sensor adds none.
LEAST_NOISE_RATIO: Final = 0.3


class ClippedNoise:
    """The noise of the sums, and what sums of an untouched skin read because taxels clip it at 0.

    Parameters
    ----------
    clips : bool
        Nodes that average undo the clipping themselves; an analogue front end clips no taxel.

    Attributes
    ----------
    noise_n : float
        Standard deviation of a sum in the newest window, median of all sums, newtons.
    bias_n : array, shape (m,), or float
        What sums read without offsets and forces, as solvers and models expect it, newtons.
    """

    def __init__(self, phi: Sbhe, *, clips: bool) -> None:
        size = phi.block_size
        self._least_n = LEAST_NOISE_RATIO * NOISE_N * size**0.5 if clips else float("inf")
        self._clipped_n = np.where(phi.row_of_sum == 0, size * IDLE_MEAN * NOISE_N, 0.0)
        self.noise_n = 0.0
        self.bias_n: Floats | float = 0.0

    def take(self, window: Window) -> None:
        """Look at the next window."""
        self.noise_n = float(np.median(window.noise_n[window.known])) if window.known.any() else 0.0

    def learn_bias(self) -> None:
        """Set the bias to that of the present noise."""
        self.bias_n = self._clipped_n if self.noise_n >= self._least_n else 0.0
