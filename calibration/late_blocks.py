"""Blocks that came after the zero was measured get theirs when nothing touches them."""

from collections import deque
from typing import NamedTuple

import numpy as np

from calibration.drift import line_through
from calibration.windows import TARE_WINDOWS, Bools, Floats, Window
from skin.phi import Sbhe


class LateZero(NamedTuple):
    """The arguments of `calibration.drift.DriftFollower.begin`."""

    sums: Bools
    level_n: Floats
    slope_n: Floats
    age: int


class LateBlocks:
    """Counts the windows in which nothing touched the blocks without a zero."""

    def __init__(self, phi: Sbhe) -> None:
        self._phi = phi
        self._recent: deque[Window] = deque(maxlen=TARE_WINDOWS)
        self._windows = np.zeros(phi.blocks, np.intp)

    def skip(self) -> None:
        """Begin to wait anew."""
        self._windows[:] = 0

    def take(self, window: Window, known: Bools, held: Bools) -> LateZero | None:
        """Take a window; return the zero of the sums whose blocks have waited long enough, None without any.

        Parameters
        ----------
        known : array of bool, shape (m,)
            Sums that have a zero.
        held : array of bool, shape (blocks,)
            Blocks under a touch.
        """
        self._recent.append(window)
        free = ~self._phi.all_of_blocks(known) & ~held & self._phi.all_of_blocks(window.known)
        self._windows = np.where(free, self._windows + 1, 0)
        ready = self._windows >= TARE_WINDOWS
        if not ready.any():
            return None
        level_n, slope_n, _ = line_through(np.stack([each.mean_n for each in self._recent]))
        return LateZero(self._phi.sums_of_blocks(ready), level_n, slope_n, TARE_WINDOWS)
