"""Defects of taxels and of analogue sums: `KINDS` has one row for each kind.

`skin.taxel.TaxelModel` applies the stages of taxels, `skin.frontend.SumModel` those of sums.

Each defect has a seed, which selects its taxels and their amounts: the same seed gives the same defective skin in every
run. The paper's data have no defects; the paper names a damper, without a value.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum, auto
from functools import cached_property, lru_cache, partial
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.layout import Layout
from skin.ranges import listed, require_number
from skin.zero_drift import ZeroDrift, parse_drifts

#: Spring of one taxel: force in newtons = STIFFNESS_N_PER_M x compression in metres (section V).
STIFFNESS_N_PER_M: Final = 1.0
#: Standard deviation of a noisy taxel's noise / range.
NOISY_RATIO: Final = 0.25
#: Time constants of creep.
RISE_S: Final = 60.0
RECOVERY_S: Final = 30.0

Force = npt.NDArray[np.float32]


class Stage(IntEnum):
    """Where a defect acts, in the order of the signal; in brackets the effect that `Kind.make` returns."""

    #: Consecutive moments (called with forces (moments, ...) and the period in seconds, returns forces).
    SPEED = auto()
    #: Consecutive moments (called as `creep` without its ratio).
    MEMORY = auto()
    #: The force (called with forces (..., rows, columns), returns forces).
    FORCE = auto()
    #: The zero (offset of each taxel, newtons).
    OFFSET = auto()
    #: The zero (called with times (moments,) in seconds, returns offsets (moments, rows, columns)).
    DRIFT = auto()
    #: The noise (flat indices of taxels, and their standard deviation in newtons).
    NOISE = auto()
    #: The reading (flat indices of taxels, and what they always read in newtons).
    READING = auto()
    #: The two paths of an analogue sum (`SumGains`).
    SUM_PATHS = auto()
    #: The time between two analogue sums of a block (seconds).
    SUM_TIME = auto()
    #: The zero of an analogue sum (offset of each sum, newtons).
    SUM_OFFSET = auto()
    #: The noise behind the addition (standard deviation in newtons).
    SUM_NOISE = auto()

    @property
    def is_of_sums(self) -> bool:
        """Whether only boards with an analogue front end have this stage."""
        return self >= Stage.SUM_PATHS


#: Stages at which a skin without touch no longer reads zero.
ZERO_STAGES: Final = (Stage.OFFSET, Stage.DRIFT, Stage.SUM_OFFSET)
#: Stages whose amounts are newtons, or newtons a second, up to the range of a taxel or of a sum.
_NEWTON_STAGES: Final = (Stage.DRIFT, Stage.SUM_OFFSET, Stage.SUM_NOISE)


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


class Case(NamedTuple):
    """The array that a defect meets.

    Attributes
    ----------
    amount : float
    shape : tuple of int
        (rows, columns) of the taxels, or (sums,).
    force_max_n : float
        End of the taxels' range.
    random : numpy.random.Generator
        Of the kind and the seed of the defect.
    """

    amount: float
    shape: tuple[int, ...]
    force_max_n: float
    random: np.random.Generator

    def normal(self, mean: float, *shape: int) -> npt.NDArray[np.float64]:
        """Return normal numbers around `mean`, their deviation is the amount; default shape: one for each element."""
        return self.random.normal(mean, self.amount, shape or self.shape)

    def chosen(self) -> npt.NDArray[np.intp]:
        """Return flat indices of the part `amount` of the elements: of one at least, unless the amount is 0."""
        count = math.prod(self.shape)
        chosen = max(round(self.amount * count), 1 if self.amount > 0 else 0)
        return np.sort(self.random.choice(count, chosen, replace=False))


def creep(ratio: float, force_n: Force, memory_n: Force | float, period_s: float) -> tuple[Force, Force]:
    """Return the readings of taxels that yield under force and need time to recover, and their memory at the end.

    The memory w follows the force f, with the time constant `RISE_S` while f > w and `RECOVERY_S` while f < w::

        dw/dt = (f - w) / τ          reading = f + ratio (2 min(f, w) - w)

    Under a constant force the reading creeps from f to (1 + ratio) f. After its release the reading is -ratio w: the
    zero is low by up to ratio x force, and recovers. Ten minutes of 10 mN with a ratio of 0.05 leave -0.5 mN, of which
    a third remains after 33 s.

    Parameters
    ----------
    force_n : array of float32, shape (moments, ...)
        Each force has acted since the moment before, `period_s` ago.
    memory_n : array of float32, shape (...), or float
        Memory one period before the first moment; 0 for a rested skin.
    """
    readings_n = np.empty_like(force_n)
    rise, recovery = (np.float32(-math.expm1(-period_s / each)) for each in (RISE_S, RECOVERY_S))
    memory = np.broadcast_to(np.asarray(memory_n, np.float32), force_n.shape[1:])
    for moment, force in enumerate(force_n):
        memory = memory + np.where(force > memory, rise, recovery) * (force - memory)
        readings_n[moment] = force + np.float32(ratio) * (2 * np.minimum(force, memory) - memory)
    return readings_n, memory


def _damper(case: Case) -> Callable[[Force, float], Force]:
    """Damping beside each spring, N s/m."""

    def damped(force_n: Force, period_s: float) -> Force:
        """Add damping x speed of compression, at most down to a force of 0; the speed at the first moment is 0."""
        compression_m = force_n / np.float32(STIFFNESS_N_PER_M)
        speed = np.diff(compression_m, axis=0, prepend=compression_m[:1]) / np.float32(period_s)
        return np.maximum(force_n + np.float32(case.amount) * speed, np.float32(0.0))

    return damped


def _creep(case: Case) -> Callable[[Force, Force | float, float], tuple[Force, Force]]:
    """Part of a force by which its reading creeps up, and the zero is low afterwards."""
    return partial(creep, case.amount)


def _cross_talk(case: Case) -> Callable[[Force], Force]:
    """Fraction of the force of each neighbour that a taxel reads in addition."""

    def mixed(force_n: Force) -> Force:
        mixed_n = force_n.copy()
        part = np.float32(case.amount) * force_n
        mixed_n[..., 1:, :] += part[..., :-1, :]
        mixed_n[..., :-1, :] += part[..., 1:, :]
        mixed_n[..., :, 1:] += part[..., :, :-1]
        mixed_n[..., :, :-1] += part[..., :, 1:]
        return mixed_n

    return mixed


def _swapped(case: Case) -> Callable[[Force], Force]:
    """Fraction of taxels whose wires are exchanged in pairs."""
    return _rewired(case, case.chosen(), is_exchange=True)


def _doubled(case: Case) -> Callable[[Force], Force]:
    """Fraction of taxels whose place is wired to another taxel."""
    return _rewired(case, case.chosen(), is_exchange=False)


def _rewired(case: Case, first: npt.NDArray[np.intp], *, is_exchange: bool) -> Callable[[Force], Force]:
    others = np.setdiff1d(np.arange(math.prod(case.shape)), first)
    first = first[: others.size]
    second = case.random.choice(others, first.size, replace=False)
    taxel_of = np.arange(math.prod(case.shape))
    taxel_of[first] = second
    if is_exchange:
        taxel_of[second] = first
    return lambda force_n: force_n.reshape(*force_n.shape[:-2], -1)[..., taxel_of].reshape(force_n.shape)


def _gain_spread(case: Case) -> Callable[[Force], Force]:
    """Standard deviation of the gains around 1."""
    gains = np.maximum(case.normal(1.0), 0.0).astype(np.float32)
    return lambda force_n: force_n * gains


def _offset(case: Case) -> Force:
    """Largest offset / range; uniform from 0."""
    return case.random.uniform(0.0, case.amount * case.force_max_n, case.shape).astype(np.float32)


def _drift(case: Case) -> Callable[[npt.NDArray[np.float64]], Force]:
    """Standard deviation of the drift of the zero point, N/s."""
    rates_n_per_s = case.normal(0.0)
    return lambda time_s: np.multiply.outer(time_s, rates_n_per_s).astype(np.float32)


def _noisy(case: Case) -> tuple[npt.NDArray[np.intp], float]:
    """Fraction of taxels with noise of a quarter of the range."""
    return case.chosen(), NOISY_RATIO * case.force_max_n


def _stuck(case: Case) -> tuple[npt.NDArray[np.intp], Force]:
    """Fraction of taxels that read one value of the range."""
    chosen = case.chosen()
    return chosen, case.random.uniform(0.0, case.force_max_n, chosen.size).astype(np.float32)


def _saturated(case: Case) -> tuple[npt.NDArray[np.intp], float]:
    """Fraction of taxels that read the end of the range."""
    return case.chosen(), case.force_max_n


def _dead(case: Case) -> tuple[npt.NDArray[np.intp], float]:
    """Fraction of taxels that read 0."""
    return case.chosen(), 0.0


def _mismatch(case: Case) -> SumGains:
    """Standard deviation of the gains of added and of subtracted taxels around 1."""
    plus, minus = np.maximum(case.normal(1.0, 2, *case.shape), 0.0)
    return SumGains((plus + minus) / 2, (plus - minus) / 2)


def _skew(case: Case) -> float:
    """Time between two sums of a block, s; the first is read at SYNC."""
    return case.amount


def _sum_offset(case: Case) -> Force:
    """Standard deviation of the offsets of sums, N."""
    return case.normal(0.0).astype(np.float32)


def _sum_noise(case: Case) -> float:
    """Standard deviation of the noise behind the addition, N."""
    return case.amount


class Kind(NamedTuple):
    """A kind of defect.

    Attributes
    ----------
    stage : Stage
    make : callable
        Returns the effect that the stage expects, of a `Case`; its docstring is the meaning of the amount.
    amount : str
        Name of the amount, with its unit.
    default : float
        Default amount.
    most : float
        Largest amount; the smallest is 0.
    stream : int or None
        Stream of the random numbers: kinds of one seed select different taxels. None: nothing is drawn.
    """

    stage: Stage
    make: Callable[[Case], Any]
    amount: str
    default: float
    most: float = 1.0
    stream: int | None = None

    @property
    def help(self) -> str:
        """The meaning of the amount."""
        return (self.make.__doc__ or "").strip()


#: Kind by name; options write a hyphen for the underscore. Defects of one stage act in this order.
KINDS: Final = {
    "damper": Kind(Stage.SPEED, _damper, "damping_n_s_per_m", 0.01, 100.0),
    "creep": Kind(Stage.MEMORY, _creep, "ratio", 0.05),
    "cross_talk": Kind(Stage.FORCE, _cross_talk, "ratio", 0.1),
    "gain_spread": Kind(Stage.FORCE, _gain_spread, "deviation", 0.1, stream=0),
    "swapped": Kind(Stage.FORCE, _swapped, "ratio", 0.001, stream=9),
    "doubled": Kind(Stage.FORCE, _doubled, "ratio", 0.001, stream=10),
    "offset": Kind(Stage.OFFSET, _offset, "ratio", 0.13, stream=6),
    "drift": Kind(Stage.DRIFT, _drift, "deviation_n_per_s", 1e-4, math.inf, stream=1),
    "noisy": Kind(Stage.NOISE, _noisy, "ratio", 0.01, stream=5),
    "stuck": Kind(Stage.READING, _stuck, "ratio", 0.01, stream=2),
    "saturated": Kind(Stage.READING, _saturated, "ratio", 0.01, stream=4),
    "dead": Kind(Stage.READING, _dead, "ratio", 0.01, stream=3),
    "mismatch": Kind(Stage.SUM_PATHS, _mismatch, "deviation", 0.01, stream=7),
    "skew": Kind(Stage.SUM_TIME, _skew, "row_s", 1e-4, math.inf),
    "sum_offset": Kind(Stage.SUM_OFFSET, _sum_offset, "deviation_n", 0.01, math.inf, stream=8),
    "sum_noise": Kind(Stage.SUM_NOISE, _sum_noise, "deviation_n", 0.001, math.inf),
}


@dataclass(frozen=True)
class Defect:
    """One defect: a kind of `KINDS`, its amount, and the seed of what it draws."""

    kind: str
    amount: float
    seed: int = 0

    def __post_init__(self) -> None:
        kind = KINDS[self.kind]
        require_number(f"{option_name(self.kind)}: {kind.amount}", self.amount, kind.most)


class Stop(NamedTuple):
    """A block whose converters stop at a time, seconds from the first step, while its board's frames go on.

    `taxels` and `sums` are the numbers of its taxels and sums.
    """

    start_s: float
    taxels: list[int]
    sums: slice


@dataclass(frozen=True)
class Defects:
    """All defects of a skin.

    Attributes
    ----------
    of_kinds : tuple of Defect
        Each kind once.
    zero_drifts, sum_drifts : tuple of ZeroDrift
        Drifts of the zero of taxels, and of analogue sums, at a place.
    stops : tuple of Stop
        Boards whose converters stop.
    """

    of_kinds: tuple[Defect, ...] = ()
    zero_drifts: tuple[ZeroDrift, ...] = ()
    sum_drifts: tuple[ZeroDrift, ...] = ()
    stops: tuple[Stop, ...] = ()

    @classmethod
    def of(cls, amounts: Mapping[str, float | None], seed: int = 0) -> "Defects":
        """Return the defects of these amounts by kind; None or 0: no defect."""
        return cls(tuple(Defect(kind, amount, seed) for kind, amount in amounts.items() if amount))

    @cached_property
    def stages(self) -> dict[Stage, tuple[Defect, ...]]:
        """The defects of each stage that has any, in the order of `KINDS`."""
        found: dict[Stage, tuple[Defect, ...]] = {}
        for defect in sorted(self.of_kinds, key=lambda each: list(KINDS).index(each.kind)):
            stage = KINDS[defect.kind].stage
            found[stage] = (*found.get(stage, ()), defect)
        return found

    @property
    def moves_zero(self) -> bool:
        """Whether the skin may read something without touch, apart from noise."""
        return bool(self.zero_drifts or self.sum_drifts) or not self.stages.keys().isdisjoint(ZERO_STAGES)

    def effects(self, stage: Stage, shape: tuple[int, ...], force_max_n: float = math.nan) -> list[Any]:
        """Return what the defects of a stage do to an array of `shape`, see `Stage`; arrays are read-only."""
        return [_effect(defect, shape, force_max_n) for defect in self.stages.get(stage, ())]


NO_DEFECTS: Final = Defects()


# Made once per array, because live nodes need the effects in every cycle.
@lru_cache(maxsize=64)
def _effect(defect: Defect, shape: tuple[int, ...], force_max_n: float) -> Any:
    kind = KINDS[defect.kind]
    random = np.random.default_rng(np.random.SeedSequence(defect.seed, spawn_key=(kind.stream or 0,)))
    effect = kind.make(Case(defect.amount, shape, force_max_n, random))
    for array in effect if isinstance(effect, tuple) else (effect,):
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    return effect


def option_name(kind: str) -> str:
    """Return the name of a kind in options."""
    return kind.replace("_", "-")


def parse_stops(texts: Iterable[str], layout: Layout) -> tuple[Stop, ...]:
    """Return the boards of an option whose converters stop, each ``BLOCK`` or ``BLOCK:START_S``."""
    made = []
    for text in listed(texts):
        block, _, start_s = text.partition(":")
        try:
            number, begin_s = int(block), float(start_s or 0)
        except ValueError:
            number, begin_s = -1, 0.0
        if not (0 <= number < layout.blocks and 0 <= begin_s < math.inf):
            raise InputError(
                f"--frozen {text}: expected BLOCK or BLOCK:START_S with a block from 0 to {layout.blocks - 1},"
                " and seconds"
            )
        phi = layout.phi()
        made.append(Stop(begin_s, phi.taxels_of(number).tolist(), slice(*phi.starts[number : number + 2].tolist())))
    return tuple(made)


def parse_defects(kinds: Iterable[str], drifts: Iterable[str], seed: int, layout: Layout) -> Defects:
    """Return the defects of the options ``--defect`` and ``--drift``.

    Parameters
    ----------
    kinds : iterable of str
        Each KIND or KIND=AMOUNT, for example ``dead`` or ``cross-talk=0.05``; a kind once.
    drifts : iterable of str
        As for `skin.zero_drift.parse_drifts`.
    seed : int
        Seed of the choice of taxels.
    layout : Layout
        Only an analogue front end has defects of sums.
    """
    made = {}
    for text in listed(kinds):
        name, given, amount = text.partition("=")
        kind = name.strip().replace("-", "_")
        if kind not in KINDS:
            offered = [each for each in KINDS if layout.taxels.is_analogue or not KINDS[each].stage.is_of_sums]
            known = ", ".join(map(option_name, offered))
            raise InputError(f"--defect {text}: expected KIND or KIND=AMOUNT with KIND of {known}")
        if KINDS[kind].stage.is_of_sums and not layout.taxels.is_analogue:
            raise InputError(f'--defect {text}: expected a layout with taxels.frontend = "analogue"')
        if kind in made:
            raise InputError(f"--defect {text}: expected each kind once")
        try:
            made[kind] = Defect(kind, float(amount) if given else KINDS[kind].default, seed)
            if (stage := KINDS[kind].stage) in _NEWTON_STAGES:
                most_n = layout.taxels.force_max_n * (layout.measurement.block_size if stage.is_of_sums else 1)
                require_number(f"{name}: {KINDS[kind].amount}", made[kind].amount, most_n)
        except InputError as error:
            raise InputError(f"--defect {error}") from error
        except ValueError:
            raise InputError(f"--defect {text}: expected a number after '=', got '{amount}'") from None
    return Defects(tuple(made.values()), *parse_drifts(drifts, seed, layout))
