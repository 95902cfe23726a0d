"""Taxel sources and training touches, found by name.

A source returns the force on every taxel at each step of the SYNC clock: a simulator, a recording, a robot's own
electronics. A generator of touches draws labelled images for training. Python packages offer both as entry points:

- ``canskin.sources``: taxel sources. ``touch`` offers ``objects`` and ``recording``; ``nodes``, ``bandwidth`` and
  ``demo`` load them.
- ``canskin.touches``: labelled touches. ``touch`` offers ``random``; ``classifier`` loads it.

This module is the only place where one package of this distribution uses another through an entry point. The import
rules do not see this use. So a skin with its own source runs without ``touch``.
"""

import inspect
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.layout import Layout, Taxels
from skin.ranges import listed

#: Groups of entry points.
SOURCES: Final = "canskin.sources"
TOUCHES: Final = "canskin.touches"
#: Name in `TOUCHES` of the touches for training: random places, depths and moments.
RANDOM: Final = "random"
#: Default objects of the simulated skin and of the classifier.
DEFAULT_OBJECTS: Final = ("golf-ball", "granola-box", "tuna-can", "ring", "basketball")
#: Objects that one name stands for, wherever names of objects are taken: those of the paper's classification.
OBJECT_GROUPS: Final = {
    "paper": (
        "racquetball",
        "volleyball",
        "basketball",
        "cracker-box",
        "cereal-box",
        "jello-box",
        "granola-box",
        "gravy-can",
        "tuna-can",
        "salmon-can",
        "banana",
        "cup",
        "drill",
        "clamp",
        "mustard-lying",
        "mustard-upright",
    )
}
#: How simulated objects touch: ``slide`` presses at any place and angle and slides; ``press`` presses as the paper's
#: classification data, within 10 mm and 45 degrees of the middle and 9.99 mm deep, without a slide.
StrokeKind = Literal["slide", "press"]


class Frame(NamedTuple):
    """Forces at one instant: ``force_n`` (rows, columns) in newtons, and the name of the touching object."""

    force_n: npt.NDArray[np.float32]
    label: str


class TaxelSource(Protocol):
    """The force on every taxel at steps 0, 1, 2, …, `step_rate_hz` of them in a second."""

    #: True if the values contain a real sensor's noise, so no noise is added.
    has_noise: bool

    def frame(self, step: int) -> Frame:
        """Return the touch at `step`; the same step always gives the same touch."""
        ...


def step_rate_hz(layout: Layout) -> float:
    """Return the steps of a touch in a second: `Sending.step_hz`, or one each SYNC at its highest rate."""
    return layout.sends.step_hz or 1 / layout.sync.period_s


def load_source(name: str, **options: Any) -> TaxelSource:
    """Build the taxel source registered under `name`."""
    source: TaxelSource = _load(SOURCES, name)(**options)
    return source


def load_objects(layout: Layout, **options: Any) -> TaxelSource:
    """Build the source of simulated objects on a skin, at `step_rate_hz`; untouchable taxels feel nothing.

    The entry point is called with ``(rows=, columns=, pitch_m=, rate_hz=)``, with ``surface=`` for a skin that is no
    grid (`skin.surface.Surface`), and with the options.
    """
    taxels, factory = layout.taxels, _load(SOURCES, "objects")
    source: TaxelSource = factory(**_places(taxels, factory), rate_hz=step_rate_hz(layout), **options)
    return _Sheltered(source, layout) if taxels.untouchable or taxels.shape else source


def _places(taxels: Taxels, factory: Callable[..., Any]) -> dict[str, Any]:
    """Return the arguments that tell an entry point where the taxels lie."""
    places = {"rows": taxels.rows, "columns": taxels.columns, "pitch_m": taxels.pitch_m}
    if taxels.positions is None:
        return places
    known = inspect.signature(factory).parameters.values()
    if not any(each.name == "surface" or each.kind is each.VAR_KEYWORD for each in known):
        origin = f"{factory.__module__}:{factory.__qualname__}"
        raise InputError(f"{origin} knows no taxels at positions: expected a parameter `surface`, or a grid")
    return {**places, "surface": taxels.surface}


class _Sheltered:
    """A source without force on the taxels that nothing can touch, and at gaps."""

    def __init__(self, source: TaxelSource, layout: Layout) -> None:
        self.has_noise = source.has_noise
        self._source, self._layout = source, layout

    def frame(self, step: int) -> Frame:
        """Return the touch at `step`."""
        frame = self._source.frame(step)
        return frame._replace(force_n=_sheltered(frame.force_n, self._layout))


def _sheltered(force_n: npt.NDArray[np.float32], layout: Layout) -> npt.NDArray[np.float32]:
    """Return forces (..., rows, columns) without those on taxels that nothing can touch, and at gaps."""
    force_n = np.array(force_n, np.float32)
    force_n.reshape(-1, layout.taxels.count)[:, [*(layout.taxels.untouchable or ()), *layout.taxels.gaps]] = 0
    return force_n


def object_names(given: Iterable[str]) -> tuple[str, ...]:
    """Return names of objects, each once, with the objects of `OBJECT_GROUPS` in place of the name of a group.

    Examples
    --------
    >>> object_names(["ring,cup", "ring"])
    ('ring', 'cup')
    """
    return tuple(dict.fromkeys(name for each in listed(given) if each for name in OBJECT_GROUPS.get(each, (each,))))


def object_file(name: str) -> Path | None:
    """Return the file of an object that is the user's own mesh, ``FILE@UNIT``; None for a name."""
    file, _, unit = name.rpartition("@")
    return Path(file) if file and unit else None


def object_label(name: str) -> str:
    """Return what labels call an object: its name, or the name of its file without the ending.

    Examples
    --------
    >>> object_label("meshes/handle.stl@mm:y90")
    'handle'
    """
    file = object_file(name)
    return name if file is None else file.stem


def known_objects(touching: Iterable[str]) -> tuple[str, ...]:
    """Return the objects of a classifier: those that touch and, for a realistic choice, the default objects.

    A whole group of `OBJECT_GROUPS` is a choice by itself. An own object takes the place of the one of its name.
    """
    names = tuple(touching)
    if names in OBJECT_GROUPS.values():
        return names
    own = {object_label(name) for name in names if object_file(name) is not None}
    return tuple(dict.fromkeys((*(name for name in DEFAULT_OBJECTS if name not in own), *names)))


class LabelledTouches(NamedTuple):
    """Observations: ``force_n`` float32 (count, rows, columns) in newtons, ``labels`` (count,) of names."""

    force_n: npt.NDArray[np.float32]
    labels: npt.NDArray[np.str_]


def load_touches(
    names: Sequence[str], count: int, layout: Layout, *, seed: int, stroke: StrokeKind = "slide"
) -> LabelledTouches:
    """Return labelled touches of the named objects, true forces without noise, drawn by the entry point `RANDOM`.

    The entry point is called with ``(names, count, rows=, columns=, pitch_m=, seed=, skip_unfelt=)``, with ``surface=``
    for a skin that is no grid, with ``stroke="press"`` where this kind is wanted, and returns images and labels.
    Default objects that are too large for the skin are left out.
    """
    draw = _load(TOUCHES, RANDOM)
    force_n, labels = draw(
        list(names),
        count,
        **_places(layout.taxels, draw),
        seed=seed,
        skip_unfelt=tuple(names) == DEFAULT_OBJECTS,
        **({} if stroke == "slide" else {"stroke": stroke}),
    )
    return LabelledTouches(_sheltered(force_n, layout), np.asarray(labels, np.str_))


def _load(group: str, name: str) -> Callable[..., Any]:
    found = {entry.name: entry for entry in entry_points(group=group)}
    if name not in found:
        offered = ", ".join(sorted(found)) or "nothing"
        raise InputError(f"no '{name}' in the entry points '{group}': installed distributions offer {offered}")
    factory: Callable[..., Any] = found[name].load()
    return factory
