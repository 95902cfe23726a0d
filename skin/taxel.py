"""The taxel and its converter: from the force on a taxel to the sensor signal and to ADC counts.

Nodes, simulators, training and comparisons use this model of noise, range, resolution and defects::

    force ─▶ speed, memory, force, zero ─▶ noise ─▶ range ─▶ readings ─▶ ADC
             └──────────────── TaxelModel.signal ──────────────────┘  to_counts

The words are stages of `skin.defects.Stage`.

The paper adds normal noise of 1 mN and clips to 0 to 20 mN (section V): this is `sense`.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.defects import NO_DEFECTS, Defects, Force, Stage
from skin.layout import Taxels
from skin.ranges import require_above_zero

#: Standard deviation of the sensor noise, as in the paper.
NOISE_N: Final = 1e-3
#: End of the range of the default skin's taxels, as in the paper.
FORCE_MAX_N: Final = Taxels().force_max_n
#: What the defects of the stage `MEMORY` keep of the forces so far, by place among them.
Memory = dict[int, Force]


def sense(
    force_n: npt.NDArray[np.floating],
    rng: np.random.Generator,
    noise_n: float | Force = NOISE_N,
    force_max_n: float = FORCE_MAX_N,
    *,
    dtype: type[np.float32 | np.float64] = np.float32,
) -> npt.NDArray[Any]:
    """Return the sensor signal: normal noise is added, then values are clipped to the taxel's range.

    Parameters
    ----------
    force_n : numpy.ndarray
        True force of any shape, newtons.
    rng : numpy.random.Generator
        Source of the noise.
    noise_n : float or array
        Standard deviation of the noise, newtons; an array must broadcast to the shape of `force_n`.
    force_max_n : float
        End of the range, newtons.
    dtype : type
        Precision of noise and signal, ``numpy.float32`` or ``numpy.float64``.

    Returns
    -------
    numpy.ndarray
        Of `dtype`, the shape of `force_n`.
    """
    _check(noise_n, force_max_n)
    signal = _with_noise(force_n, rng, noise_n, dtype)
    np.clip(signal, 0.0, dtype(force_max_n), out=signal)
    return signal


def _with_noise(
    force_n: npt.NDArray[np.floating],
    rng: np.random.Generator,
    noise_n: float | Force,
    dtype: type[np.float32 | np.float64],
) -> npt.NDArray[Any]:
    """Return forces with normal noise added, in new memory."""
    if isinstance(noise_n, float) and noise_n == 0.0:
        return np.array(force_n, dtype)
    signal: npt.NDArray[Any] = rng.standard_normal(np.shape(force_n), dtype=dtype)
    signal *= np.asarray(noise_n, dtype)
    signal += force_n
    return signal


def to_counts(signal_n: npt.NDArray[np.floating], taxels: Taxels) -> npt.NDArray[np.int32]:
    """Return the ADC counts of a sensor signal, rounded and limited to the range; same shape."""
    counts = signal_n / signal_n.dtype.type(taxels.newton_per_count)
    np.rint(counts, out=counts)
    np.clip(counts, 0, taxels.count_max, out=counts)
    return counts.astype(np.int32)


def corrected(
    counts: npt.NDArray[Any], gain: npt.NDArray[np.float32], offset: npt.NDArray[np.float32], taxels: Taxels
) -> npt.NDArray[np.float32]:
    """Return ``gain * counts + offset`` of ADC counts or their averages, limited to the range; same shape.

    The product is rounded to float32 before the offset is added: the result is the same on every board.
    """
    values = counts.astype(np.float32)
    with np.errstate(over="ignore"):  # an SDO write may set a huge gain; the result is clipped
        values *= gain
    values += offset
    np.clip(values, 0, taxels.count_max, out=values)
    return values


def to_newtons(counts: npt.NDArray[np.integer], taxels: Taxels) -> Force:
    """Return the forces of ADC counts; same shape."""
    return counts.astype(np.float32) * np.float32(taxels.newton_per_count)


@dataclass(frozen=True)
class TaxelModel:
    """Noise, range and defects of the taxels of one array.

    The defects act in the order of `skin.defects.Stage`; the drifts of places act last on the zero. A taxel that is
    both stuck and dead reads 0.

    Attributes
    ----------
    noise_n, force_max_n : float
        As for `sense`.
    defects : Defects
    """

    noise_n: float = NOISE_N
    force_max_n: float = FORCE_MAX_N
    defects: Defects = NO_DEFECTS

    def __post_init__(self) -> None:
        _check(self.noise_n, self.force_max_n)

    def signal(self, force_n: Force, rng: np.random.Generator, *, period_s: float, start_s: float = 0.0) -> Force:
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
            float32, the same shape. The damper takes a speed of 0 at the first step, and the skin has rested before.
        """
        if force_n.ndim != 3:
            raise InputError(f"expected forces of shape (steps, rows, columns), got {force_n.shape}")
        require_above_zero("period_s", period_s)
        force_n, _ = self.remembered_n(self.damped_n(force_n, period_s), {}, period_s)
        return self.signal_of_moments(force_n, rng, start_s + period_s * np.arange(len(force_n), dtype=np.float64))

    def signal_of_moments(
        self, force_n: Force, rng: np.random.Generator, time_s: npt.NDArray[np.float64], *, clips: bool = True
    ) -> Force:
        """Return the sensor signal of single moments, without the stages `SPEED` and `MEMORY`.

        Parameters
        ----------
        force_n : numpy.ndarray
            True force, float32, shape (moments, rows, columns), newtons.
        rng : numpy.random.Generator
            Source of the noise.
        time_s : numpy.ndarray
            Time of each moment, shape (moments,); drift is 0 at time 0.
        clips : bool
            Taxels end at 0 and at the end of the range; false where their currents are added (`skin.frontend`).

        Returns
        -------
        numpy.ndarray
            float32, the same shape.
        """
        taxels = force_n.shape[1:]
        signal: Force = _with_noise(self.felt_n(force_n, time_s), rng, self.noise_of(taxels), np.float32)
        if clips:
            np.clip(signal, 0.0, np.float32(self.force_max_n), out=signal)
        fixed_n = self.fixed_n(taxels)
        if fixed_n is not None:
            np.copyto(signal, fixed_n, where=~np.isnan(fixed_n))
        return signal

    def damped_n(self, force_n: Force, period_s: float) -> Force:
        """Return forces of consecutive moments, shape (moments, rows, columns), after the stage `SPEED`."""
        for effect in self._effects(Stage.SPEED, force_n.shape[1:]):
            force_n = effect(force_n, period_s)
        return force_n

    def remembered_n(self, force_n: Force, memory: Memory, period_s: float) -> tuple[Force, Memory]:
        """Return forces of consecutive moments, shape (moments, rows, columns), after the stage `MEMORY`.

        Parameters
        ----------
        memory : dict
            What the call for the moments before has returned; empty for a skin that has rested.

        Returns
        -------
        force_n : numpy.ndarray
        memory : dict
        """
        kept: Memory = {}
        for number, effect in enumerate(self._effects(Stage.MEMORY, force_n.shape[1:])):
            force_n, kept[number] = effect(force_n, memory.get(number, 0.0), period_s)
        return force_n, kept

    def felt_n(self, force_n: Force, time_s: npt.NDArray[np.float64]) -> Force:
        """Return forces of moments, shape (moments, rows, columns), after the stages from `FORCE` to `DRIFT`."""
        taxels = force_n.shape[1:]
        for effect in self._effects(Stage.FORCE, taxels):
            force_n = effect(force_n)
        for offset_n in self._effects(Stage.OFFSET, taxels):
            force_n = np.add(force_n, offset_n)
        for drift in self._effects(Stage.DRIFT, taxels):
            force_n = np.add(force_n, drift(time_s))
        for place in self.defects.zero_drifts:
            force_n = np.add(force_n, place.offsets_n(taxels, time_s))
        return force_n

    def drifted_n(self, taxels: tuple[int, ...], time_s: float) -> Force:
        """Return how far the zeros of an array of shape `taxels` have drifted by place at a time, newtons."""
        drifts, at = self.defects.zero_drifts, np.array([time_s])
        return sum((each.offsets_n(taxels, at)[0] for each in drifts), np.zeros(taxels, np.float32))

    def noise_of(self, taxels: tuple[int, ...]) -> float | Force:
        """Return the standard deviation of the noise of an array of shape `taxels`, newtons, for all or for each."""
        effects = self._effects(Stage.NOISE, taxels)
        return _with_chosen(np.full(taxels, self.noise_n, np.float32), effects) if effects else self.noise_n

    def fixed_n(self, taxels: tuple[int, ...]) -> Force | None:
        """Return what the taxels always read that have a defect of the stage `READING`, newtons; None without any.

        The array has the shape `taxels` and is NaN for all other taxels.
        """
        effects = self._effects(Stage.READING, taxels)
        return _with_chosen(np.full(taxels, np.nan, np.float32), effects) if effects else None

    def _effects(self, stage: Stage, taxels: tuple[int, ...]) -> list[Any]:
        return self.defects.effects(stage, taxels, self.force_max_n)


def _with_chosen(values_n: Force, effects: list[tuple[npt.NDArray[np.intp], Any]]) -> Force:
    for chosen, value_n in effects:
        values_n.reshape(-1)[chosen] = value_n
    return values_n


def _check(noise_n: float | Force, force_max_n: float) -> None:
    smallest, largest = (noise_n, noise_n) if isinstance(noise_n, float) else (np.min(noise_n), np.max(noise_n))
    require_above_zero("force_max_n", force_max_n)
    if not 0 <= smallest <= largest <= force_max_n:
        raise InputError(f"noise_n needs numbers from 0 to {force_max_n:g}, the range of a taxel: got {noise_n}")
