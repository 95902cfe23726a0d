"""Means of the sums over windows of time, and the noise in them, in fixed memory."""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

#: Length of a window, and the fewest cycles in it.
WINDOW_S: Final = 0.25
LEAST_CYCLES: Final = 8
#: Windows over which the zero is measured.
TARE_WINDOWS: Final = 8
#: From the moment a sum is valid until it counts: nodes that average learn their noise first.
SETTLE_S: Final = 0.5
#: Part of a window's cycles in which a sum has to be valid to count. A sum that was away for more cycles in a row
#: settles again: its node may have started anew. Lost frames cost their cycles alone.
LEAST_PART: Final = 0.5
#: Mean of |a - b| over the standard deviation of normal a and b.
_SIZE_OF_DIFFERENCE: Final = 2 / math.sqrt(math.pi)

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


def mean_window_s(period_s: float) -> float:
    """Return the length of a window, seconds, of cycles `period_s` apart."""
    return max(WINDOW_S, LEAST_CYCLES * period_s)


def tare_s(period_s: float) -> float:
    """Return for how long a skin must be untouched for its zero, seconds."""
    return TARE_WINDOWS * mean_window_s(period_s)


def change(means_n: Floats) -> Floats:
    """Return the change from the first to the second half of windows, shape (windows, m)."""
    half = len(means_n) // 2
    change: Floats = means_n[half:].mean(axis=0) - means_n[:half].mean(axis=0)
    return change


def typical(deviation_n: Floats) -> float:
    """Return the root mean square of deviations, without those that are far above the others."""
    square = deviation_n**2
    limit = 9 * max(float(np.median(square)), float(square.mean()) / 9)
    return float(np.minimum(square, limit).mean() ** 0.5)


def rms(values: Floats) -> float:
    """Return the root mean square of values, 0 of none."""
    return float(np.mean(values**2) ** 0.5) if values.size else 0.0


class Window(NamedTuple):
    """The sums of one window.

    Attributes
    ----------
    centre_ns : int
        Middle of the window, on the clock of the measurements.
    mean_n : array, shape (m,)
        Mean of each sum, newtons; 0 where `known` is False.
    noise_n : array, shape (m,)
        Standard deviation of one cycle's sum, from differences between one valid cycle and the next, newtons.
    difference_n : array, shape (m,)
        Change of each sum in the last cycle, newtons.
    known : array of bool, shape (m,)
        False for sums that were not valid, or not for long enough.
    """

    centre_ns: int
    mean_n: Floats
    noise_n: Floats
    difference_n: Floats
    known: Bools


class WindowMeans:
    """Collects cycles into windows.

    Parameters
    ----------
    sums : int
        m.
    period_s : float
        From cycle to cycle.
    """

    def __init__(self, sums: int, period_s: float, newton_per_count: float) -> None:
        self.length_ns = round(1e9 * mean_window_s(period_s))
        self._cycles = self.length_ns * 1e-9 / period_s
        self._newton_per_count = newton_per_count
        self._begin_ns = self._end_ns = 0
        self._total, self._difference = np.zeros((2, sums))
        self._last, self._newest = np.zeros((2, sums))
        self._count = np.zeros(sums, np.int64)
        #: Cycles in a row, up to the newest, in which each sum was not valid.
        self._missed = np.full(sums, round(self._cycles))
        self._valid_since_ns = np.zeros(sums, np.int64)

    def take(self, time_ns: int, counts: npt.NDArray[np.int32], valid: Bools) -> Window | None:
        """Take a cycle; return the window that ended before, if one did.

        Parameters
        ----------
        time_ns : int
            A gap, or a step back, begins a new window.
        counts : array of int32, shape (m,)
        valid : array of bool, shape (m,)
            False for sums that did not come, or are saturated.
        """
        ended = None
        if not self._begin_ns <= time_ns < self._end_ns:
            if self._end_ns and self._end_ns <= time_ns < self._end_ns + self.length_ns:
                ended = self._close()
            if time_ns < self._begin_ns:
                self._valid_since_ns[:] = time_ns
            self._begin(time_ns)
        self._valid_since_ns[valid & (self._missed > LEAST_PART * self._cycles)] = time_ns
        settled = valid & (time_ns - self._valid_since_ns >= SETTLE_S * 1e9)
        self._total += np.where(settled, counts, 0)
        np.subtract(counts, self._last, out=self._newest)
        self._newest[~settled] = 0
        self._difference += np.abs(self._newest)
        self._count += settled
        np.copyto(self._last, counts, where=valid)
        self._missed = np.where(valid, 0, self._missed + 1)
        return ended

    def restart(self) -> None:
        """Drop the cycles of the present window."""
        self._end_ns = 0

    def _begin(self, time_ns: int) -> None:
        self._begin_ns, self._end_ns = time_ns, time_ns + self.length_ns
        for each in (self._total, self._difference, self._count):
            each[...] = 0

    def _close(self) -> Window:
        known = self._count >= LEAST_PART * self._cycles
        count = np.maximum(self._count, 1)
        mean_n = np.where(known, self._total / count, 0) * self._newton_per_count
        noise_n = np.where(known, self._difference / count, 0) * self._newton_per_count / _SIZE_OF_DIFFERENCE
        newest_n = self._newest * self._newton_per_count
        return Window((self._begin_ns + self._end_ns) // 2, mean_n, noise_n, newest_n, known)
