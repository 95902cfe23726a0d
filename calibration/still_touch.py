"""A touch that stands still, and what its field does not explain of the sums: what changes then is drift."""

from typing import Final

import numpy as np

from calibration.windows import TARE_WINDOWS, Floats
from skin.phi import Sbhe

#: A touch stands still while no taxel changes by more than this part of the largest force.
STILL_PART: Final = 0.1
#: Offsets follow what has no pattern by this part of it in each window.
STILL_GAIN: Final = 0.04


class StillTouch:
    """Means over the windows of a touch that stands still, until it has stood for the time of a tare.

    Attributes
    ----------
    force_n : array, shape (n,)
        Of the touch, newtons.
    expected_n : array, shape (m,)
        What is left of the sums without their offsets while the touch stands, newtons.
    """

    def __init__(self, phi: Sbhe) -> None:
        self.force_n, self.expected_n = np.zeros(phi.shape[1]), np.zeros(phi.shape[0])
        self._first_n = self.force_n
        self._windows = 0

    @property
    def is_known(self) -> bool:
        """Whether a touch has stood still for long enough."""
        return self._windows >= TARE_WINDOWS

    def end(self) -> None:
        """Wait for another touch."""
        self._windows = 0

    def goes_on(self, change_n: Floats) -> bool:
        """Tell whether the touch still stands, when its taxels have changed by `change_n`, shape (n,), newtons."""
        if np.abs(change_n).max() > STILL_PART * self.force_n.max():
            self.end()
        return self.is_known

    def take(self, field_n: Floats, left_n: Floats) -> None:
        """Take the field, shape (n,), and the sums less their offsets, shape (m,), of the next window, newtons."""
        force_n = np.maximum(field_n, 0)
        if not force_n.any() or np.abs(force_n - self._first_n).max() > STILL_PART * force_n.max():
            self.end()
        if self._windows == 0:
            self._first_n = force_n
            self.force_n, self.expected_n = np.zeros_like(force_n), np.zeros_like(left_n)
        self._windows += 1
        self.force_n = self.force_n + field_n / TARE_WINDOWS
        self.expected_n = self.expected_n + left_n / TARE_WINDOWS

    def drift_n(self, left_n: Floats, changed_n: Floats) -> Floats:
        """Return by how much the offsets follow in a window, shape (m,), newtons.

        Parameters
        ----------
        left_n : array, shape (m,)
            Sums less their offsets.
        changed_n : array, shape (m,)
            The part of that by which the touch has changed.
        """
        return STILL_GAIN * (left_n - self.expected_n - changed_n)
