"""What real taxels do beside noise: each effect a small value class, off unless `touch.electronics` is given one.

What belongs to a taxel (its gain, whether it is dead) is drawn from the effect's own seed and is the same in every
run. None of them is in the paper's data; a damper is named there, without a value.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skin.errors import InputError
from touch.contact import STIFFNESS_N_PER_M, Force

#: Streams of random numbers, so that effects of one seed do not meet the same taxels.
_GAIN, _DRIFT, _STUCK, _DEAD = range(4)


@dataclass(frozen=True)
class Damper:
    """A damper beside each spring: force grows with the speed of compression (section V, without a value).

    It pushes back while the taxel is pressed and lets a released taxel feel less, never less than nothing.
    """

    damping_n_s_per_m: float

    def __post_init__(self) -> None:
        _need_ratio("damping_n_s_per_m", self.damping_n_s_per_m, math.inf)

    def __call__(self, force_n: Force, period_s: float) -> Force:
        """Return forces (steps, ...) with the damper's part; the first step counts as at rest."""
        compression_m = force_n / np.float32(STIFFNESS_N_PER_M)
        speed = np.diff(compression_m, axis=0, prepend=compression_m[:1]) / np.float32(period_s)
        return np.maximum(force_n + np.float32(self.damping_n_s_per_m) * speed, np.float32(0.0))


@dataclass(frozen=True)
class CrossTalk:
    """Each taxel also reads a part of each of its four neighbours' force."""

    ratio: float

    def __post_init__(self) -> None:
        _need_ratio("ratio", self.ratio, 1.0)

    def __call__(self, force_n: Force) -> Force:
        """Return forces (..., rows, columns) with the neighbours' part."""
        mixed = force_n.copy()
        part = np.float32(self.ratio) * force_n
        mixed[..., 1:, :] += part[..., :-1, :]
        mixed[..., :-1, :] += part[..., 1:, :]
        mixed[..., :, 1:] += part[..., :, :-1]
        mixed[..., :, :-1] += part[..., :, 1:]
        return mixed


@dataclass(frozen=True)
class GainSpread:
    """Each taxel reads its force times a gain of its own, normal around 1 and never below 0."""

    deviation: float
    seed: int = 0

    def __post_init__(self) -> None:
        _need_ratio("deviation", self.deviation, 1.0)

    def gains(self, taxels: tuple[int, ...]) -> Force:
        """Return the gain of each taxel of an array of that shape."""
        drawn = _stream(self.seed, _GAIN).normal(1.0, self.deviation, taxels)
        return np.maximum(drawn, 0.0).astype(np.float32)


@dataclass(frozen=True)
class Drift:
    """The zero of each taxel moves at a constant rate of its own, normal around 0."""

    deviation_n_per_s: float
    seed: int = 0

    def __post_init__(self) -> None:
        _need_ratio("deviation_n_per_s", self.deviation_n_per_s, math.inf)

    def offsets_n(self, taxels: tuple[int, ...], time_s: npt.NDArray[np.float64]) -> Force:
        """Return offsets of shape (times, *taxels), newtons."""
        rates = _stream(self.seed, _DRIFT).normal(0.0, self.deviation_n_per_s, taxels)
        return np.multiply.outer(time_s, rates).astype(np.float32)


@dataclass(frozen=True)
class Stuck:
    """A part of the taxels, at least one unless 0, always reads one value of the range."""

    ratio: float
    seed: int = 0

    def __post_init__(self) -> None:
        _need_ratio("ratio", self.ratio, 1.0)

    def values(self, taxels: tuple[int, ...], force_max_n: float) -> tuple[npt.NDArray[np.intp], Force]:
        """Return flat indices of the stuck taxels and what each reads, newtons."""
        rng = _stream(self.seed, _STUCK)
        chosen = _chosen(self.ratio, taxels, rng)
        return chosen, rng.uniform(0.0, force_max_n, chosen.size).astype(np.float32)


@dataclass(frozen=True)
class Dead:
    """A part of the taxels, at least one unless 0, always reads 0."""

    ratio: float
    seed: int = 0

    def __post_init__(self) -> None:
        _need_ratio("ratio", self.ratio, 1.0)

    def taxels(self, taxels: tuple[int, ...]) -> npt.NDArray[np.intp]:
        """Return flat indices of the dead taxels."""
        return _chosen(self.ratio, taxels, _stream(self.seed, _DEAD))


def _need_ratio(name: str, value: float, most: float) -> None:
    if not (math.isfinite(value) and 0 <= value <= most):
        expected = "a number of 0 or more" if most == math.inf else f"a number from 0 to {most:g}"
        raise InputError(f"{name} needs {expected}: got {value}")


def _stream(seed: int, effect: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(effect,)))


def _chosen(ratio: float, taxels: tuple[int, ...], rng: np.random.Generator) -> npt.NDArray[np.intp]:
    count = math.prod(taxels)
    chosen = max(round(ratio * count), 1 if ratio > 0 else 0)
    return np.sort(rng.choice(count, chosen, replace=False))
