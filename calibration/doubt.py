"""Which forces may be errors of the zero: those that stand still, as a warm patch does.

A still weight and a patch of the skin that has warmed cannot be told from each other by what the taxels read. So a
force is doubtful when for `STILL_S` it did not fall below most of what it is now, hardly changed from window to window,
and is no more than zeros move by.
"""

import math
from typing import Final

import numpy as np

from calibration.windows import Floats

#: Time after which a force that stands still is doubtful.
STILL_S: Final = 6.0
#: Least doubtful force, and the largest error of a zero, both as part of the range.
LEAST_RATIO: Final = 0.015
MOST_RATIO: Final = 0.4
#: At least this part of a force has to be still.
CONSTANT_PART: Final = 0.5
#: From window to window a still force changes by this part of itself and of the range, but for some windows.
CHANGE_PART: Final = 0.05
CHANGE_RATIO: Final = 0.015
QUIET_PART: Final = 0.6


class Doubt:
    """Looks at the forces of each window.

    Parameters
    ----------
    force_max_n : float
        End of the range.

    Attributes
    ----------
    taxels : array of bool, shape (n,)
        Whose force is doubtful.
    since_ns : int
        When the first of them became doubtful; 0 without any.
    """

    def __init__(self, taxels: int, force_max_n: float, window_s: float) -> None:
        windows = max(3, math.ceil(STILL_S / window_s))
        self.taxels = np.zeros(taxels, np.bool_)
        self.since_ns = 0
        self._range_n = force_max_n
        self._seen_n = np.zeros((windows, taxels), np.float32)
        self._is_quiet = np.zeros((windows, taxels), np.bool_)
        self._next = self._count = 0

    def take(self, force_n: Floats, time_ns: int) -> None:
        """Take what stands above the zero, shape (n,), newtons, in the window at `time_ns`."""
        last_n, place = self._seen_n[self._next - 1], self._next
        allowed_n = CHANGE_PART * last_n + CHANGE_RATIO * self._range_n
        self._is_quiet[place] = np.abs(force_n - last_n) <= allowed_n
        self._seen_n[place] = force_n
        self._next = (place + 1) % len(self._seen_n)
        self._count += 1
        least_n = LEAST_RATIO * self._range_n
        if self._count < len(self._seen_n) or force_n.max() <= least_n:
            found = np.zeros_like(self.taxels)
        else:
            still_n = self._seen_n.min(axis=0)
            found = (still_n > least_n) & (still_n >= CONSTANT_PART * force_n) & (still_n < MOST_RATIO * self._range_n)
            found &= self._is_quiet.mean(axis=0) >= QUIET_PART
        self.taxels = found
        self.since_ns = (self.since_ns or time_ns) if found.any() else 0

    def move(self, change_n: Floats) -> None:
        """Follow the zero, which was moved by a field, shape (n,), newtons."""
        self._seen_n = np.maximum(self._seen_n - change_n.astype(np.float32), 0)
