"""From the true force to the sensor signal: noise and limits as in the paper, and what else real taxels do.

The paper adds normal noise of 1 mN and clips to 0 to 20 mN (section V); `sense` does that and no more.
`Electronics` adds the effects of `touch.effects` it is given.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.errors import InputError
from touch.contact import FORCE_MAX_N, Force
from touch.effects import CrossTalk, Damper, Dead, Drift, GainSpread, Stuck

NOISE_N: Final = 1e-3
PERIOD_S: Final = 1e-3


def sense(
    force_n: npt.NDArray[np.floating],
    rng: np.random.Generator,
    noise_n: float = NOISE_N,
    force_max_n: float = FORCE_MAX_N,
) -> Force:
    """Return the sensor signal: normal noise is added, then values are clipped to the taxel's range.

    Parameters
    ----------
    force_n : numpy.ndarray
        True force of any shape, newtons.
    rng : numpy.random.Generator
        Source of the noise.
    noise_n : float
        Standard deviation of the noise, newtons.
    force_max_n : float
        End of the range, newtons.

    Returns
    -------
    numpy.ndarray
        float32, the same shape.

    Raises
    ------
    InputError
        If the noise is below 0 or the range is empty.
    """
    _check(noise_n, force_max_n)
    signal = rng.standard_normal(np.shape(force_n), dtype=np.float32)
    signal *= np.float32(noise_n)
    signal += force_n
    np.clip(signal, 0.0, np.float32(force_max_n), out=signal)
    return signal


@dataclass(frozen=True)
class Electronics:
    """All of a taxel: noise and range as in the paper, and the effects that are given.

    Effects act in the order of their attributes; noise and clipping come before stuck and dead.

    Attributes
    ----------
    noise_n, force_max_n : float
        As for `sense`.
    damper, cross_talk, gain_spread, drift, stuck, dead
        None where the effect is off.

    Raises
    ------
    InputError
        If the noise is below 0 or the range is empty.
    """

    noise_n: float = NOISE_N
    force_max_n: float = FORCE_MAX_N
    damper: Damper | None = None
    cross_talk: CrossTalk | None = None
    gain_spread: GainSpread | None = None
    drift: Drift | None = None
    stuck: Stuck | None = None
    dead: Dead | None = None

    def __post_init__(self) -> None:
        _check(self.noise_n, self.force_max_n)

    def signal(
        self, force_n: Force, rng: np.random.Generator, *, period_s: float = PERIOD_S, start_s: float = 0.0
    ) -> Force:
        """Return the sensor signal of consecutive steps.

        Parameters
        ----------
        force_n : numpy.ndarray
            True force, float32, shape (steps, rows, columns), newtons.
        rng : numpy.random.Generator
            Source of the noise.
        period_s : float
            Time between two steps.
        start_s : float
            Time of the first step; drift is 0 at time 0.

        Returns
        -------
        numpy.ndarray
            float32, the same shape.

        Raises
        ------
        InputError
            If the forces are not of that shape, or a number cannot be used.
        """
        if force_n.ndim != 3:
            raise InputError(f"expected forces of shape (steps, rows, columns), got {force_n.shape}")
        if not (math.isfinite(period_s) and period_s > 0):
            raise InputError(f"period_s needs a number above 0: got {period_s}")
        taxels = force_n.shape[1:]
        if self.damper is not None:
            force_n = self.damper(force_n, period_s)
        if self.cross_talk is not None:
            force_n = self.cross_talk(force_n)
        if self.gain_spread is not None:
            force_n = force_n * self.gain_spread.gains(taxels)
        if self.drift is not None:
            time_s = np.asarray(start_s + period_s * np.arange(len(force_n)), np.float64)
            force_n = np.add(force_n, self.drift.offsets_n(taxels, time_s))
        signal = sense(force_n, rng, self.noise_n, self.force_max_n)
        flat = signal.reshape(len(signal), -1)
        if self.stuck is not None:
            indices, values = self.stuck.values(taxels, self.force_max_n)
            flat[:, indices] = values
        if self.dead is not None:
            flat[:, self.dead.taxels(taxels)] = 0.0
        return signal


def _check(noise_n: float, force_max_n: float) -> None:
    if not (math.isfinite(noise_n) and noise_n >= 0):
        raise InputError(f"noise_n needs a number of 0 or more: got {noise_n}")
    if not (math.isfinite(force_max_n) and force_max_n > 0):
        raise InputError(f"force_max_n needs a number above 0: got {force_max_n}")
