"""``skin evaluate``: the paper's tables and figures made again, and what goes beyond them."""

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from canskin.errors import InputError
from shell.terminal import Json, print_json, print_table

if TYPE_CHECKING:
    from evaluation.result import Options, Result

Subject = Literal[
    "paper",
    "settings",
    "sparsity",
    "compression",
    "iterations",
    "figures",
    "classification",
    "rivals",
    "recognition",
    "calibration",
    "single-wire",
]


class _Subject(NamedTuple):
    """The function ``options -> Result`` of a subject, and whether it averages over draws of Φ."""

    function: str
    draws: bool = False


#: Those of ``paper`` in the order of the report, then the others.
SUBJECTS: Final[dict[str, _Subject]] = {
    "settings": _Subject("evaluation.settings:evaluate"),
    "sparsity": _Subject("evaluation.paper.sparsity:evaluate"),
    "compression": _Subject("evaluation.paper.tables:compression", draws=True),
    "iterations": _Subject("evaluation.paper.tables:iterations", draws=True),
    "figures": _Subject("evaluation.paper.figures:evaluate"),
    "classification": _Subject("evaluation.recognition.classification:evaluate", draws=True),
    "rivals": _Subject("evaluation.schemes.comparison:evaluate"),
    "recognition": _Subject("evaluation.recognition.methods_compared:evaluate", draws=True),
    "calibration": _Subject("evaluation.schemes.zero_scenes:evaluate"),
    "single-wire": _Subject("evaluation.single_wire:evaluate"),
}


def evaluate(
    subject: Subject,
    recordings: Path | None = None,
    *,
    quick: bool = False,
    meshes: Path | None = None,
    objects: str | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    draws: int | None = None,
    seed: int = 0,
    scenes: int = 10,
    scene_seed: int | None = None,
    json: Json = False,
) -> None:
    """Make tables and figures of the paper again and print ours beside the paper's numbers.

    Parameters
    ----------
    subject
        What to evaluate. ``paper``: ``settings``, ``sparsity``, ``compression``, ``iterations``, ``figures`` and
        ``classification``, together; every number that the paper prints is compared with ours, and ``report.html`` and
        ``paper.json`` are written into the folder `out`.
    recordings
        Of ``single-wire``: a copy of github.com/aslepyan/SPTS.
    quick
        A look at everything in a small fraction of the time, with fewer steps and draws.
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) in place of the shapes that ship. Live rows of
        ``recognition`` that name objects keep these shapes.
    objects
        Comma-separated: what slides in ``rivals`` in place of the paper's five objects. Of these, or your own mesh as
        FILE@UNIT.
    out
        Folder for the report and for measured results, which a later run takes up. Default for ``paper``:
        skin-evaluation.
    jobs
        Processes at the same time. Default: one per core.
    draws
        Draws of Φ to average over, in ``compression``, ``iterations``, ``classification`` and ``recognition``. Default:
        each subject's own.
    seed
        Of all random numbers but those that draw scenes.
    scenes
        Scenes drawn at random: the number of those of ``rivals``, and half the number of those that ``calibration``
        measures beside the named ones; 2 and none with `quick`.
    scene_seed
        Of the scenes drawn at random: a seed that nobody has tried shows scenes that nobody has tuned to. ``rivals``
        shows drawn scenes with a seed alone, ``calibration`` those of seed 0 without one.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate paper --quick
    skin evaluate paper --meshes ycb-meshes --out report
    skin evaluate rivals --objects handle.stl@mm:y90,cup
    skin evaluate rivals --scene-seed 71
    """
    from evaluation.result import Options
    from touch.trajectory import checked_slides

    names = _names(subject)
    _check(subject, names, draws, objects, has_recordings=recordings is not None, has_scenes=scene_seed is not None)
    if out is None and subject == "paper":
        out = Path("skin-evaluation")
    processes = jobs if jobs is not None else os.cpu_count() or 1
    options = Options(quick, meshes, recordings, out, processes, draws, seed, scenes, scene_seed)
    if objects is not None:
        options = replace(options, objects=checked_slides(objects))
    results: dict[str, Result] = {}
    for name in names:
        asked = options if SUBJECTS[name].draws else replace(options, draws=None)
        module, _, function = SUBJECTS[name].function.partition(":")
        found = results[name] = getattr(import_module(module), function)(asked)
        if not found.rows:
            raise InputError(f"'{subject}' measured nothing: {found.note or found.title}")
        if not json:
            _print(found)
    if subject == "paper":
        results = {"paper": _compare(results, options), **results}
        if not json:
            _print(results["paper"])
    if out is not None:
        from evaluation.report import write_report

        print(f"report: {write_report(results, options, out)}", file=sys.stderr)
    if json:
        rows = [{"subject": name, **row} for name, found in results.items() for row in found.rows]
        print_json({"rows": rows, "notes": [found.note for found in results.values() if found.note]})


def _names(subject: Subject) -> list[str]:
    """Return the subjects that are evaluated, in the order of the report."""
    if subject != "paper":
        return [subject]
    from evaluation.reached import SUBJECTS as PRINTED

    return [name for name in SUBJECTS if name in PRINTED]


def _check(
    subject: Subject,
    names: Sequence[str],
    draws: int | None,
    objects: str | None,
    *,
    has_recordings: bool,
    has_scenes: bool,
) -> None:
    """Raise InputError for an option that is missing or that the subject does not take."""
    if subject == "single-wire" and not has_recordings:
        raise InputError(
            "single-wire needs a copy of github.com/aslepyan/SPTS: give the folder, skin evaluate single-wire DIR"
        )
    if draws is not None and not any(SUBJECTS[name].draws for name in names):
        raise InputError(f"'{subject}' averages over no draws of Φ, got {draws} draws: leave out --draws")
    if objects is not None and (subject != "rivals" or has_scenes):
        raise InputError(f"only the slides of 'rivals' have objects to choose, got --objects {objects}: leave it out")


def _print(found: "Result") -> None:
    print_table(list(found.rows[0]) if found.rows else [], map(dict.values, found.rows), title=found.title)
    print(f"{found.note}\n" if found.note else "")


def _compare(results: "dict[str, Result]", options: "Options") -> "Result":
    """Compare every number that the paper prints with ours, and keep the comparison."""
    from evaluation import reached

    kept = reached.stored({name: found.rows for name, found in results.items()}, options)
    if options.out is not None:
        reached.write(kept, options.out / reached.FILE)
    return reached.result(kept.numbers)
