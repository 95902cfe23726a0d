"""How the zero of the taxels drifts with time at a place of the skin."""

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.layout import Layout
from skin.ranges import listed, require_number

Force = npt.NDArray[np.float32]
_Floats = npt.NDArray[np.float64]
Place = Literal["whole", "half", "gradient", "patch", "cells"]

#: Stream of the random numbers that place patches, beside those of `skin.defects`.
_PATCH: Final = 100
#: What a drift has reached of its amount, by time since its start and by duration; `step` has no duration.
_COURSES: Final[dict[str, Callable[[_Floats, float], _Floats]]] = {
    "step": lambda since_s, _duration_s: (since_s >= 0).astype(np.float64),
    "ramp": lambda since_s, duration_s: np.clip(since_s / duration_s, 0, 1),
    "exponential": lambda since_s, duration_s: -np.expm1(-np.maximum(since_s, 0) / duration_s),
    "daily": lambda since_s, duration_s: np.sin(2 * np.pi * np.maximum(since_s, 0) / duration_s),
}
#: Default duration, seconds.
_DURATIONS_S: Final = {"step": 0.0, "ramp": 60.0, "exponential": 60.0, "daily": 86_400.0}
#: A simulated board's temperature explains its drift: kelvin without drift, and drift per kelvin.
REST_K: Final = 298.15
DRIFT_N_PER_K: Final = 5e-4
_FORM: Final = "PLACE:COURSE:AMOUNT_N[:START_S[:DURATION_S]]"
_PLACE: Final = re.compile(
    r"(?P<name>whole|half|gradient)"
    r"|patch(?P<side>\d{1,3})(@(?P<row>\d{1,3}),(?P<column>\d{1,3}))?"
    r"|(?P<of>board|converter)(?P<block>\d{1,5})"
)
_PLACES: Final = "whole, half, gradient, patchSIDE, patchSIDE@ROW,COLUMN, boardBLOCK or converterBLOCK"


@dataclass(frozen=True)
class ZeroDrift:
    """The zero of some taxels moves: amount x weight of the taxel x course over time.

    Attributes
    ----------
    place : {"whole", "half", "gradient", "patch", "cells"}
        Weight 1 for all taxels, for the left half, for a square of `side` taxels with its first taxel at `corner` (row,
        column; None: drawn with `seed`), or for the flat indices `cells`, for example the taxels of a board. Weight 0
        to 1 across the columns for ``gradient``.
    course : {"step", "ramp", "exponential", "daily"}
        From 0 to 1 at `start_s`; evenly in `duration_s`, then constant; 1 - exp(-t / `duration_s`); a sine with the
        period `duration_s`. All are 0 before `start_s`.
    amount_n : float
        Newtons, positive or negative.
    start_s : float
        Seconds from the first step.
    duration_s : float, optional
        Default: 60 s, ``daily`` 24 h; ``step`` has none.
    """

    place: Place
    course: str
    amount_n: float
    start_s: float = 0.0
    duration_s: float | None = None
    side: int = 0
    corner: tuple[int, int] | None = None
    cells: tuple[int, ...] = ()
    seed: int | tuple[int, int] = 0

    def __post_init__(self) -> None:
        if self.place not in get_args(Place) or self.course not in _COURSES:
            expected = f"one of {', '.join(get_args(Place))} and one of {', '.join(_COURSES)}"
            raise InputError(f"expected {expected}: got {self.place} and {self.course}")
        if not math.isfinite(self.amount_n):
            raise InputError(f"amount_n needs a number: got {self.amount_n}")
        require_number("start_s", self.start_s)
        if self.duration_s is not None and (self.course == "step" or not 0 < self.duration_s < math.inf):
            expected = "no number with step" if self.course == "step" else "a number above 0"
            raise InputError(f"duration_s needs {expected}: got {self.duration_s}")

    def offsets_n(self, taxels: tuple[int, ...], time_s: _Floats) -> Force:
        """Return offsets of shape (times, *taxels), newtons."""
        duration_s = _DURATIONS_S[self.course] if self.duration_s is None else self.duration_s
        course_n = self.amount_n * _COURSES[self.course](time_s - self.start_s, duration_s)
        offsets_n: Force = np.multiply.outer(course_n.astype(np.float32), _weights(self, taxels))
        return offsets_n


def parse_drifts(
    texts: Iterable[str], seed: int, layout: Layout
) -> tuple[tuple[ZeroDrift, ...], tuple[ZeroDrift, ...]]:
    """Return the drifts of an option: those of taxels, and those of analogue sums.

    The converter of a board is behind its taxels, or, with an analogue front end, behind its sums. So with a digital
    front end ``converterBLOCK`` is ``boardBLOCK``.

    Parameters
    ----------
    texts : iterable of str
        Each ``PLACE:COURSE:AMOUNT_N[:START_S[:DURATION_S]]``, for example ``patch12:ramp:0.003:10:60``.
    seed : int
        Places patches without place: each text has another.
    """
    of_taxels: list[ZeroDrift] = []
    of_sums: list[ZeroDrift] = []
    for number, text in enumerate(listed(texts)):
        try:
            is_of_sums, drift = _parsed(text, (seed, number), layout)
        except InputError as error:
            raise InputError(f"--drift {text}: {error}") from error
        (of_sums if is_of_sums else of_taxels).append(drift)
    return tuple(of_taxels), tuple(of_sums)


def _parsed(text: str, seed: tuple[int, int], layout: Layout) -> tuple[bool, ZeroDrift]:
    """Return whether a drift is one of analogue sums, and the drift."""
    place, *rest = text.split(":")
    found = _PLACE.fullmatch(place)
    if found is None or not 2 <= len(rest) <= 4 or rest[0] not in _COURSES:
        raise InputError(f"expected {_FORM} with PLACE of {_PLACES}, and COURSE of {', '.join(_COURSES)}")
    try:
        amount_n, *times_s = map(float, rest[1:])
    except ValueError:
        raise InputError(f"expected numbers after {rest[0]}, got '{':'.join(rest[1:])}'") from None
    when: dict[str, Any] = dict(zip(("start_s", "duration_s"), times_s, strict=False))
    when |= {"course": rest[0], "amount_n": amount_n}
    is_of_sums = found["of"] == "converter" and layout.taxels.is_analogue
    force_max_n = layout.taxels.force_max_n
    if not is_of_sums and abs(amount_n) > force_max_n:
        raise InputError(f"expected an amount of at most {force_max_n:g} N, the range of a taxel, got {amount_n:g}")
    if found["name"]:
        return False, ZeroDrift(**when | {"place": found["name"]})
    if found["side"]:
        corner = (int(found["row"]), int(found["column"])) if found["row"] else None
        drift = ZeroDrift("patch", **when, side=int(found["side"]), corner=corner, seed=seed)
        _weights(drift, (layout.taxels.rows, layout.taxels.columns))
        return False, drift
    block = int(found["block"])
    if block >= layout.blocks:
        raise InputError(f"expected a block from 0 to {layout.blocks - 1}, got {block}")
    phi = layout.phi()
    if is_of_sums:
        return True, ZeroDrift("cells", **when, cells=tuple(range(*phi.starts[block : block + 2].tolist())))
    return False, ZeroDrift("cells", **when, cells=tuple(phi.taxels_of(block).tolist()))


# Made once per array, because live nodes need them in every cycle.
@lru_cache(maxsize=32)
def _weights(drift: ZeroDrift, taxels: tuple[int, ...]) -> Force:
    weights = np.zeros(taxels, np.float32)
    if drift.place == "cells":
        weights.reshape(-1)[list(drift.cells)] = 1
    elif drift.place == "patch":
        room = np.array(taxels) - drift.side
        random = np.random.default_rng(np.random.SeedSequence(drift.seed, spawn_key=(_PATCH,)))
        corner = drift.corner
        if drift.side >= 1 and (room >= 0).all() and corner is None:
            row, column = random.integers(0, room + 1).tolist()
            corner = row, column
        if corner is None or drift.side < 1 or (np.array(corner) > room).any():
            raise InputError(f"expected a patch within {' x '.join(map(str, taxels))} taxels, of a side of 1 or more")
        weights[tuple(slice(first, first + drift.side) for first in corner)] = 1
    else:
        across = np.linspace(0, 1, taxels[-1])
        weights[:] = {"whole": np.ones_like(across), "half": across < 0.5, "gradient": across}[drift.place]
    weights.flags.writeable = False
    return weights
