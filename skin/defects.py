"""Defects of taxels and of analogue sums, each a small value class.

`skin.taxel.TaxelModel` applies the defects of taxels, `skin.frontend.SumModel` those of sums.

Each defect has its own seed, which selects its taxels and their amounts: the same seed gives the same defective skin in
every run. The paper's data have no defects; the paper names a damper, without a value.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.ranges import require_number
from skin.zero_drift import Creep

#: Spring of one taxel: force in newtons = STIFFNESS_N_PER_M x compression in metres (section V).
STIFFNESS_N_PER_M: Final = 1.0
#: Standard deviation of a noisy taxel's noise / range.
NOISY_RATIO: Final = 0.25
#: Streams of random numbers: defects of one seed select different taxels.
_GAIN, _DRIFT, _STUCK, _DEAD, _SATURATED, _NOISY, _OFFSET, _MISMATCH, _SUM_OFFSET = range(9)

Force = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Damper:
    """A damper beside each spring: force grows with the speed of compression (section V, without a value).

    The damper increases the force while the compression grows, and decreases the force, at most to 0, while the
    compression falls.
    """

    damping_n_s_per_m: float

    def __post_init__(self) -> None:
        require_number("damping_n_s_per_m", self.damping_n_s_per_m)

    def __call__(self, force_n: Force, period_s: float) -> Force:
        """Return forces (steps, ...) plus the force of the damper; the speed at the first step is 0."""
        compression_m = force_n / np.float32(STIFFNESS_N_PER_M)
        speed = np.diff(compression_m, axis=0, prepend=compression_m[:1]) / np.float32(period_s)
        return np.maximum(force_n + np.float32(self.damping_n_s_per_m) * speed, np.float32(0.0))


@dataclass(frozen=True)
class CrossTalk:
    """Each taxel also reads `ratio` times the force of each of its four neighbours."""

    ratio: float

    def __post_init__(self) -> None:
        require_number("ratio", self.ratio, 1.0)

    def __call__(self, force_n: Force) -> Force:
        """Return forces (..., rows, columns) with cross-talk."""
        mixed = force_n.copy()
        part = np.float32(self.ratio) * force_n
        mixed[..., 1:, :] += part[..., :-1, :]
        mixed[..., :-1, :] += part[..., 1:, :]
        mixed[..., :, 1:] += part[..., :, :-1]
        mixed[..., :, :-1] += part[..., :, 1:]
        return mixed


@dataclass(frozen=True)
class GainSpread:
    """Each taxel reads gain x force; the gains are normal around 1 and never below 0."""

    deviation: float
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("deviation", self.deviation, 1.0)

    def gains(self, taxels: tuple[int, ...]) -> Force:
        """Return the gain of each taxel of an array of shape `taxels`, read-only."""
        return _gains(self, taxels)


@dataclass(frozen=True)
class Offset:
    """Each taxel reads more than its force: offsets are uniform from 0 to `ratio` of the range."""

    ratio: float
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("ratio", self.ratio, 1.0)

    def offsets_n(self, taxels: tuple[int, ...], force_max_n: float) -> Force:
        """Return the offset of each taxel of an array of shape `taxels`, newtons, read-only."""
        return _offsets(self, taxels, force_max_n)


@dataclass(frozen=True)
class Drift:
    """The zero point of each taxel drifts at a constant rate; the rates are normal around 0."""

    deviation_n_per_s: float
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("deviation_n_per_s", self.deviation_n_per_s)

    def offsets_n(self, taxels: tuple[int, ...], time_s: npt.NDArray[np.float64]) -> Force:
        """Return offsets of shape (times, *taxels), newtons."""
        return np.multiply.outer(time_s, _drift_rates(self, taxels)).astype(np.float32)


@dataclass(frozen=True)
class _PartOfTaxels:
    """A defect of `ratio` of the taxels: of at least one taxel unless `ratio` is 0."""

    ratio: float
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("ratio", self.ratio, 1.0)


@dataclass(frozen=True)
class Noisy(_PartOfTaxels):
    """A fraction of the taxels has noise with a standard deviation of `NOISY_RATIO` x range."""

    def noise_n(self, taxels: tuple[int, ...], noise_n: float, force_max_n: float) -> Force:
        """Return the standard deviation of each taxel's noise, newtons; normal taxels have `noise_n`."""
        noise = np.full(math.prod(taxels), noise_n, np.float32)
        noise[_chosen(self, _NOISY, taxels)] = NOISY_RATIO * force_max_n
        return noise.reshape(taxels)


@dataclass(frozen=True)
class Stuck(_PartOfTaxels):
    """A fraction of the taxels always reads one value of the range."""

    def values(self, taxels: tuple[int, ...], force_max_n: float) -> tuple[npt.NDArray[np.intp], Force]:
        """Return flat indices of the stuck taxels and their readings, newtons."""
        return _stuck_values(self, taxels, force_max_n)


@dataclass(frozen=True)
class Saturated(_PartOfTaxels):
    """A fraction of the taxels always reads the end of the range."""

    def taxels(self, taxels: tuple[int, ...]) -> npt.NDArray[np.intp]:
        """Return flat indices of the saturated taxels."""
        return _chosen(self, _SATURATED, taxels)


@dataclass(frozen=True)
class Dead(_PartOfTaxels):
    """A fraction of the taxels always reads 0."""

    def taxels(self, taxels: tuple[int, ...]) -> npt.NDArray[np.intp]:
        """Return flat indices of the dead taxels."""
        return _chosen(self, _DEAD, taxels)


class SumGains(NamedTuple):
    """Gains of the sums of an analogue front end, as of a differential amplifier: Φ has the rows D_k H_k + C_k H_0.

    H_k are the Hadamard rows of the sums, H_0 adds all taxels of the block.

    Attributes
    ----------
    differential : array, shape (m,)
        D = (g⁺ + g⁻) / 2, g⁺ and g⁻ the gains of the taxels that are added and subtracted.
    common_mode : array, shape (m,)
        C = (g⁺ - g⁻) / 2.
    """

    differential: npt.NDArray[np.float64]
    common_mode: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Mismatch:
    """The gains g⁺ and g⁻ of a sum's two paths are normal around 1, and never below 0."""

    deviation: float
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("deviation", self.deviation, 1.0)

    def gains(self, sums: int) -> SumGains:
        """Return the gains of `sums` sums, read-only."""
        return _sum_gains(self, sums)


@dataclass(frozen=True)
class SumOffset:
    """Each sum has an offset; the offsets are normal around 0."""

    deviation_n: float
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("deviation_n", self.deviation_n)

    def offsets_n(self, sums: int) -> Force:
        """Return the offset of each of `sums` sums, newtons, read-only."""
        return _sum_offsets(self, sums)


@dataclass(frozen=True)
class SumNoise:
    """Amplifier and converter of each sum add normal noise to that of the taxels."""

    deviation_n: float

    def __post_init__(self) -> None:
        require_number("deviation_n", self.deviation_n)


@dataclass(frozen=True)
class Skew:
    """The sums of a block are read one after the other, `row_s` apart, the first at SYNC, while the touch moves."""

    row_s: float

    def __post_init__(self) -> None:
        require_number("row_s", self.row_s)


class DefectKind(NamedTuple):
    """A kind of defect.

    Attributes
    ----------
    make : callable
        Called with amount and seed.
    amount : float
        Default amount.
    """

    make: Callable[[float, int], Any]
    amount: float


#: Kind by attribute name of `skin.taxel.TaxelModel`; options write a hyphen for the underscore.
KINDS: Final = {
    "damper": DefectKind(lambda amount, _seed: Damper(amount), 0.01),
    "cross_talk": DefectKind(lambda amount, _seed: CrossTalk(amount), 0.1),
    "gain_spread": DefectKind(GainSpread, 0.1),
    "offset": DefectKind(Offset, 0.13),
    "drift": DefectKind(Drift, 1e-4),
    "noisy": DefectKind(Noisy, 0.01),
    "stuck": DefectKind(Stuck, 0.01),
    "saturated": DefectKind(Saturated, 0.01),
    "dead": DefectKind(Dead, 0.01),
    "creep": DefectKind(lambda amount, _seed: Creep(amount), 0.05),
}
#: Kind by attribute name of `skin.frontend.SumModel`: defects of the sums of an analogue front end.
SUM_KINDS: Final = {
    "mismatch": DefectKind(Mismatch, 0.01),
    "sum_offset": DefectKind(SumOffset, 0.01),
    "sum_noise": DefectKind(lambda amount, _seed: SumNoise(amount), 0.001),
    "skew": DefectKind(lambda amount, _seed: Skew(amount), 1e-4),
}
_ALL_KINDS: Final = KINDS | SUM_KINDS


def make_defects(amounts: dict[str, float], seed: int) -> dict[str, Any]:
    """Return the defects of the named kinds, as keyword arguments of `skin.taxel.TaxelModel` or `SumModel`.

    Parameters
    ----------
    amounts : dict
        Amount by kind, one of `KINDS` or `SUM_KINDS`.
    seed : int
        Seed of the choice of taxels.

    Raises
    ------
    InputError
        If an amount cannot be used.
    """
    made = {}
    for name, amount in amounts.items():
        try:
            made[name] = _ALL_KINDS[name].make(amount, seed)
        except InputError as error:
            raise InputError(f"{name.replace('_', '-')}: {error}") from error
    return made


def parse_defects(texts: Iterable[str], seed: int, *, is_analogue: bool = False) -> dict[str, Any]:
    """Return the defects of an option, as keyword arguments of `skin.taxel.TaxelModel`.

    Parameters
    ----------
    texts : iterable of str
        Each KIND or KIND=AMOUNT, for example ``dead`` or ``cross-talk=0.05``; the last amount of a kind counts.
    seed : int
        Seed of the choice of taxels.
    is_analogue : bool
        The front end is analogue: defects of sums may be among them, see `split_by_target`.

    Raises
    ------
    InputError
        If a kind is unknown or an amount cannot be used.
    """
    kinds = _ALL_KINDS if is_analogue else KINDS
    amounts = {}
    for text in texts:
        kind, given, amount = text.partition("=")
        name = kind.strip().replace("-", "_")
        if name not in kinds:
            if name in SUM_KINDS:
                raise InputError(f'--defect {text}: expected a layout with taxels.frontend = "analogue"')
            known = ", ".join(each.replace("_", "-") for each in kinds)
            raise InputError(f"--defect {text}: expected KIND or KIND=AMOUNT with KIND of {known}")
        try:
            amounts[name] = float(amount) if given else kinds[name].amount
        except ValueError:
            raise InputError(f"--defect {text}: expected a number after '=', got '{amount}'") from None
    try:
        return make_defects(amounts, seed)
    except InputError as error:
        raise InputError(f"--defect {error}") from error


def split_by_target(defects: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Divide defects, with the drifts of `skin.zero_drift.parse_drifts`, into those of taxels and those of sums."""
    sums = {name: each for name, each in defects.items() if name in {*SUM_KINDS, "sum_drifts"}}
    return {name: each for name, each in defects.items() if name not in sums}, sums


def _stream(seed: int, defect: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(defect,)))


# Drawn once per array, because live nodes need them in every cycle.
@lru_cache(maxsize=8)
def _gains(spread: GainSpread, taxels: tuple[int, ...]) -> Force:
    drawn = _stream(spread.seed, _GAIN).normal(1.0, spread.deviation, taxels)
    return _fixed(np.maximum(drawn, 0.0).astype(np.float32))


@lru_cache(maxsize=8)
def _offsets(offset: Offset, taxels: tuple[int, ...], force_max_n: float) -> Force:
    drawn = _stream(offset.seed, _OFFSET).uniform(0.0, offset.ratio * force_max_n, taxels)
    return _fixed(drawn.astype(np.float32))


@lru_cache(maxsize=8)
def _drift_rates(drift: Drift, taxels: tuple[int, ...]) -> npt.NDArray[np.float64]:
    return _fixed(_stream(drift.seed, _DRIFT).normal(0.0, drift.deviation_n_per_s, taxels))


@lru_cache(maxsize=8)
def _stuck_values(stuck: Stuck, taxels: tuple[int, ...], force_max_n: float) -> tuple[npt.NDArray[np.intp], Force]:
    rng = _stream(stuck.seed, _STUCK)
    chosen = _draw(stuck.ratio, taxels, rng)
    return _fixed(chosen), _fixed(rng.uniform(0.0, force_max_n, chosen.size).astype(np.float32))


@lru_cache(maxsize=8)
def _sum_gains(mismatch: Mismatch, sums: int) -> SumGains:
    plus, minus = np.maximum(_stream(mismatch.seed, _MISMATCH).normal(1.0, mismatch.deviation, (2, sums)), 0.0)
    return SumGains(_fixed((plus + minus) / 2), _fixed((plus - minus) / 2))


@lru_cache(maxsize=8)
def _sum_offsets(offset: SumOffset, sums: int) -> Force:
    return _fixed(_stream(offset.seed, _SUM_OFFSET).normal(0.0, offset.deviation_n, sums).astype(np.float32))


@lru_cache(maxsize=32)
def _chosen(defect: _PartOfTaxels, stream: int, taxels: tuple[int, ...]) -> npt.NDArray[np.intp]:
    return _fixed(_draw(defect.ratio, taxels, _stream(defect.seed, stream)))


def _draw(ratio: float, taxels: tuple[int, ...], rng: np.random.Generator) -> npt.NDArray[np.intp]:
    count = math.prod(taxels)
    chosen = max(round(ratio * count), 1 if ratio > 0 else 0)
    return np.sort(rng.choice(count, chosen, replace=False))


def _fixed(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.flags.writeable = False
    return array
