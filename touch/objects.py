"""The objects that can touch the skin, by name (section V of the paper)."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Final

from skin.errors import InputError
from touch import primitives
from touch.contact import Spheres


@dataclass(frozen=True)
class TouchObject:
    """One object of the catalogue.

    Attributes
    ----------
    name, shape : str
        What it is called, and which primitive makes it.
    size_m : tuple of float
        Length and width of what faces the array, metres.
    build : callable
        Makes its spheres.
    """

    name: str
    shape: str
    size_m: tuple[float, float]
    build: Callable[[], Spheres]


def _ball(name: str, diameter_m: float) -> TouchObject:
    return TouchObject(name, "ball", (diameter_m, diameter_m), lambda: primitives.ball(diameter_m))


def _box(name: str, length_m: float, width_m: float) -> TouchObject:
    return TouchObject(name, "box", (length_m, width_m), lambda: primitives.box(length_m, width_m))


def _can(name: str, diameter_m: float) -> TouchObject:
    return TouchObject(name, "can", (diameter_m, diameter_m), lambda: primitives.can(diameter_m))


def _ring(name: str, diameter_m: float, wall_m: float) -> TouchObject:
    return TouchObject(name, "ring", (diameter_m, diameter_m), lambda: primitives.ring(diameter_m, wall_m))


#: Balls and boxes have the sizes of BubbleTouch's scripts. The paper does not give its cans: these are
#: sizes of common cans that show the confusions the paper reports. The ring has the width and the wall of the
#: paper's cup.
_OBJECTS: Final = (
    _ball("golf-ball", 0.04267),
    _ball("racquetball", 0.057),
    _ball("volleyball", 0.207),
    _ball("basketball", 0.2388),
    _box("cracker-box", 0.158, 0.060),
    _box("cereal-box", 0.197, 0.051),
    _box("jello-box", 0.085, 0.050),
    _box("granola-box", 0.141, 0.100),
    _can("gravy-can", 0.0683),
    _can("tuna-can", 0.0873),
    _can("salmon-can", 0.1032),
    _ring("ring", 0.1004, 0.0043),
)

CATALOGUE: Final = {item.name: item for item in _OBJECTS}


def checked_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` as a tuple; a string may hold several, separated by commas.

    Raises
    ------
    InputError
        If there is none, or one the catalogue does not know.
    """
    listed = tuple(part.strip() for part in names.split(",")) if isinstance(names, str) else tuple(names)
    known = ", ".join(CATALOGUE)
    if not listed:
        raise InputError(f"no object named: expected one or more of {known}")
    for name in listed:
        if name not in CATALOGUE:
            raise InputError(f"unknown object '{name}': expected one of {known}")
    return listed


@cache
def spheres_of(name: str) -> Spheres:
    """Return the spheres of the object called `name`, built once.

    Raises
    ------
    InputError
        If the catalogue has no such object.
    """
    (checked,) = checked_names([name])
    return CATALOGUE[checked].build()
