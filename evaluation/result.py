"""What an evaluation is asked, and what it answers: rows beside the paper's, and pictures."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canskin.errors import InputError
from shell.output import write_file
from touch.objects import CATALOGUE, made_of
from touch.trajectory import ACQUISITION_OBJECTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]


@dataclass(frozen=True)
class Options:
    """What every evaluation is asked: the options of ``skin evaluate``.

    Without `out` nothing is kept; without `draws` each subject has its own number. `objects` slide in place of the
    paper's five. `meshes` has a mesh of each object that the paper takes from meshes.
    """

    quick: bool = False
    meshes: Path | None = None
    recordings: Path | None = None
    out: Path | None = None
    jobs: int | str = 1
    draws: int | None = None
    seed: int = 0
    scenes: int = 10
    scene_seed: int | None = None
    objects: tuple[str, ...] = tuple(ACQUISITION_OBJECTS)

    def __post_init__(self) -> None:
        if self.recordings is not None and not self.recordings.is_dir():
            raise InputError(f"no folder '{self.recordings}': expected a folder of recordings")
        for name in CATALOGUE if self.meshes is not None else ():
            made_of(name, self.meshes)
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError(f"'{self.out}' is a file: expected a folder for the results")
        numbers = {"jobs": (self.jobs, 1), "draws": (self.draws, 1), "seed": (self.seed, 0)}
        numbers |= {"scenes": (self.scenes, 0), "scene-seed": (self.scene_seed, 0)}
        for name, (number, least) in numbers.items():
            if isinstance(number, int) and number < least:
                raise InputError(f"{name} needs a whole number of {least} or more: got {number}")

    @property
    def shared(self) -> Row:
        """The arguments ``meshes``, a path as text or None, and ``seed`` of what is measured."""
        return {"meshes": str(self.meshes) if self.meshes else None, "seed": self.seed}

    def draws_or(self, draws: int) -> int:
        """Return the draws that were asked for, else 1 for a quick look, else `draws`."""
        return self.draws or (1 if self.quick else draws)


@dataclass(frozen=True)
class Picture:
    """A plot of the report: what it shows, and what draws it."""

    caption: str
    draw: "Callable[[], Figure]"


@dataclass(frozen=True)
class Result:
    """What one evaluation found.

    Attributes
    ----------
    title : str
        One line.
    rows : list of dict
        All with the same keys in the same order; ``ours``, ``paper`` and ``difference`` where the paper has a number.
    pictures : list of Picture
        Plots of the rows.
    note : str
        Below the table.
    """

    title: str
    rows: list[Row]
    pictures: list[Picture] = field(default_factory=list)
    note: str = ""


def beside(ours: float, paper: float | None, digits: int = 2) -> Row:
    """Return the columns ``ours``, ``paper`` and ``difference``, the last two None where the paper has no number."""
    if not math.isfinite(ours):
        return {"ours": None, "paper": paper, "difference": None}
    difference = None if paper is None else round(ours - paper, digits) + 0.0  # no -0.0
    return {"ours": round(ours, digits), "paper": paper, "difference": difference}


def grouped(rows: Iterable[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Return the rows by their values of `keys`, in order of appearance."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def write_text(path: Path, text: str) -> None:
    """Write a file of results, in a folder that is made if need be; raise InputError if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text)
    except OSError as error:
        raise InputError(f"'{path}' cannot be written: {error}; give another --out") from error


def new_figure(width: float, height: float) -> "Figure":
    """Return a figure of that size in inches, whose panels do not overlap."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")
