"""The measurement of a zero: a line through the sums of some windows in which nothing touches the skin."""

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from calibration.drift import line_through
from calibration.field import FieldFinder
from calibration.windows import TARE_WINDOWS, Bools, Floats, Window, change, typical

#: Sums with a zero, part of all, with which the skin counts as tared; the others follow when their blocks are valid.
LEAST_KNOWN: Final = 0.5
#: This part of the taxels may show less than what all others have in common.
FLOOR_PART: Final = 0.02
#: Force of a single taxel that is seen, over that of a square of taxels.
SINGLE_RATIO: Final = 2.0


class MeasuredZero(NamedTuple):
    """A zero.

    Attributes
    ----------
    level_n, slope_n : array, shape (m,)
        Of the sums in the newest window, newtons, and their change in a window.
    mean_n : array, shape (m,)
        Over all windows.
    known : array of bool, shape (m,)
    noise_n : float
        Standard deviation of the mean of a window.
    touched : int or None
        The taxel where the skin is touched most or where something moves on it.
    """

    level_n: Floats
    slope_n: Floats
    mean_n: Floats
    known: Bools
    noise_n: float
    touched: int | None


class Taring:
    """Collects the windows of a zero.

    Parameters
    ----------
    least_noise_n : float
        No noise is taken to be less.

    Attributes
    ----------
    forced : bool
        Whatever touches the skin is part of its zero.
    region : array of bool, shape (n,), or None
        Whatever stands on these taxels is part of their zero.
    is_asked : bool
        By a person, who says that nothing touches the skin: what stands still and is doubtful counts as zero.
    has_few_sums : bool
        Whether the zero waits for valid sums.
    """

    def __init__(self, finder: FieldFinder, least_noise_n: float) -> None:
        self._finder, self._least_noise_n = finder, least_noise_n
        self._windows: deque[Window] = deque(maxlen=TARE_WINDOWS)
        self.forced, self.is_asked, self.has_few_sums = False, False, True
        self.region: Bools | None = None

    def begin(self, *, asked: bool = False, forced: bool = False, region: Bools | None = None) -> None:
        """Begin anew."""
        self.is_asked, self.forced, self.region, self.has_few_sums = asked, forced, region, True
        self._windows.clear()

    def restart(self) -> None:
        """Drop the windows so far."""
        self._windows.clear()

    def take(self, window: Window, before_n: Floats | None, settled: Bools, *, has_common: bool) -> MeasuredZero | None:
        """Take the next window; return the zero of the newest windows, None while they are too few.

        Parameters
        ----------
        before_n : array, shape (m,), optional
            The zero up to now, NaN for unknown sums.
        settled : array of bool, shape (n,)
            Doubtful taxels.
        has_common : bool
            The zero may have changed for all taxels alike.
        """
        self._windows.append(window)
        self.has_few_sums = float(window.known.mean()) < LEAST_KNOWN
        known = np.logical_and.reduce([each.known for each in self._windows])
        if len(self._windows) < TARE_WINDOWS or known.mean() < LEAST_KNOWN:
            return None
        means_n = np.stack([each.mean_n for each in self._windows])
        level_n, slope_n, deviation_n = line_through(means_n)
        noise_n = typical(deviation_n[known])
        touched = None
        if not self.forced and self.region is None:
            touched = self._moved(means_n, known, noise_n, has_common=has_common)
            if touched is None:
                touched = self._touched(level_n, known, noise_n, before_n, settled, has_common=has_common)
        return MeasuredZero(level_n, slope_n, means_n.mean(axis=0), known, noise_n, touched)

    def _moved(self, means_n: Floats, known: Bools, noise_n: float, *, has_common: bool) -> int | None:
        """Return the taxel where something moves most."""
        force_n, least_n = self._seen(change(means_n), known, noise_n)
        return self._largest(np.abs(force_n - np.median(force_n) if has_common else force_n), least_n)

    def _touched(
        self,
        level_n: Floats,
        known: Bools,
        noise_n: float,
        before_n: Floats | None,
        settled: Bools,
        *,
        has_common: bool,
    ) -> int | None:
        """Return the taxel that is touched most."""
        if before_n is not None:
            known = known & np.isfinite(before_n)
            level_n = np.where(known, level_n - before_n, 0.0)
        force_n, least_n = self._seen(level_n, known, noise_n)
        force_n = np.where(settled & self.is_asked, 0.0, force_n)
        if has_common:
            force_n -= np.quantile(force_n, FLOOR_PART)
        return self._largest(force_n, least_n)

    def _largest(self, force_n: Floats, least_n: float) -> int | None:
        """Return the taxel with the largest force; single taxels count only where they are far from noise."""
        seen = self._finder.opened(force_n > least_n) | (force_n > SINGLE_RATIO * least_n)
        seen_n = np.where(seen, force_n, 0.0)
        return int(seen_n.argmax()) if seen_n.any() else None

    def _seen(self, sums_n: Floats, known: Bools, noise_n: float) -> tuple[Floats, float]:
        """Return the field of sums, and from which force on a taxel is more than noise."""
        field = self._finder.find(np.where(known, sums_n, 0.0), known, max(noise_n, self._least_noise_n))
        return field.force_n, self._finder.least_n(field.noise_n)
