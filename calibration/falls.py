"""What the zero has fallen by, and may rise by again without a touch."""

from typing import Final

import numpy as np

from calibration.windows import Bools, Floats

#: Windows for which a force below 0 has to last while something touches, and without touch until a fall is right.
PROOF_WINDOWS: Final = 3
#: What fell may come back later, less this part of it each audit.
CREDIT_LOSS: Final = 0.005
#: A force of more than `RETURN_RATIO` times what fell is a touch, and does not come back.
RETURN_RATIO: Final = 1.5
#: What fell while nothing touched comes back by this part in each window: a touch of the same force lasts some seconds.
RETURN_PART: Final = 0.05


class Falls:
    """Falls of each taxel's zero.

    Parameters
    ----------
    is_credited : bool
        What falls while nothing touches may come back: the zero was measured.
    """

    def __init__(self, taxels: int, *, is_credited: bool) -> None:
        self._is_credited = is_credited
        #: What fell while something touches, and before that, newtons of each taxel.
        self._now_n, self._before_n = np.zeros((2, taxels))
        self._untouched_windows = 0

    def settle(self, region: Bools) -> None:
        """Forget the falls of the taxels of `region`, shape (n,)."""
        self._now_n[region] = self._before_n[region] = 0

    def take(self, fall_n: Floats, force_n: Floats, least_n: float, *, is_touched: bool) -> Floats:
        """Take what fell in a window, 0 or less; return what has come back of the forces, newtons, shape (n,).

        Parameters
        ----------
        force_n : array, shape (n,)
            What stands above the zero.
        least_n : float
            From which force on that is more than noise.
        """
        self._untouched_windows = 0 if is_touched else self._untouched_windows + 1
        if is_touched:
            self._now_n = self._now_n - fall_n
        else:
            self.credit(fall_n)
        if self._untouched_windows == PROOF_WINDOWS:  # what fell meanwhile is right
            self._before_n = self._before_n + self._now_n
            self._now_n = np.zeros_like(force_n)
        now_n = _back_n(self._now_n, force_n, least_n, 1.0)
        before_n = _back_n(self._before_n, force_n - now_n, least_n, RETURN_PART)
        self._now_n, self._before_n = self._now_n - now_n, self._before_n - before_n
        return now_n + before_n

    def credit(self, fall_n: Floats) -> None:
        """Take what fell while nothing touched, 0 or less, shape (n,), newtons."""
        if self._is_credited:
            self._before_n = self._before_n - fall_n

    def returned_n(self, risen_n: Floats) -> Floats:
        """Return what may have come back of a slow rise, shape (n,), newtons."""
        return np.minimum(np.maximum(risen_n, 0), self._before_n)

    def audit(self, back_n: Floats, fall_n: Floats) -> None:
        """Take off what came back slowly, and a part of the rest; take what fell slowly."""
        self._before_n = (1 - CREDIT_LOSS) * (self._before_n - back_n)
        self.credit(fall_n)


def _back_n(fallen_n: Floats, force_n: Floats, least_n: float, part: float) -> Floats:
    returns = (force_n >= least_n) & (force_n <= RETURN_RATIO * fallen_n + least_n)
    return np.where(returns, np.minimum(force_n, part * fallen_n), 0.0)
