"""``skin evaluate``: the paper's tables and figures made again, and what goes beyond them."""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, NamedTuple

from cyclopts import Parameter

from canskin.errors import InputError
from shell.terminal import Json, print_json, print_table
from shell.touch_options import FullScale

if TYPE_CHECKING:
    from evaluation.result import Options, Result

Subject = Literal[
    "all",
    "paper",
    "settings",
    "sparsity",
    "compression",
    "iterations",
    "figures",
    "rivals",
    "drawn-rivals",
    "calibration",
    "classification",
    "recognition",
    "single-wire",
    "recordings",
]


class _Subject(NamedTuple):
    """The function ``options -> Result`` of a subject; whether it averages over draws of Φ, and takes objects."""

    function: str
    draws: bool = False
    objects: bool = False


#: In the order of the report.
SUBJECTS: Final[dict[str, _Subject]] = {
    "settings": _Subject("evaluation.settings:evaluate"),
    "sparsity": _Subject("evaluation.paper.sparsity:evaluate"),
    "compression": _Subject("evaluation.paper.tables:compression", draws=True),
    "iterations": _Subject("evaluation.paper.tables:iterations", draws=True),
    "figures": _Subject("evaluation.paper.figures:evaluate"),
    "rivals": _Subject("evaluation.schemes.comparison:evaluate", objects=True),
    "drawn-rivals": _Subject("evaluation.schemes.comparison:evaluate_drawn"),
    "calibration": _Subject("evaluation.schemes.zero_scenes:evaluate"),
    "classification": _Subject("evaluation.recognition.classification:evaluate", draws=True),
    "recognition": _Subject("evaluation.recognition.methods_compared:evaluate", draws=True),
    "single-wire": _Subject("evaluation.single_wire:evaluate"),
    "recordings": _Subject("evaluation.schemes.recordings:evaluate"),
}
#: Subjects that measure recordings alone, and the recordings that each needs.
RECORDED: Final = {
    "single-wire": "a copy of github.com/aslepyan/SPTS",
    "recordings": "recordings of a pressure mat, glove or skin",
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
    scene_seed: int = 0,
    basis: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    full_scale: FullScale = None,
    rate: float | None = None,
    json: Json = False,
) -> None:
    """Make tables and figures of the paper again and print ours beside the paper's numbers.

    Parameters
    ----------
    subject
        What to evaluate. ``paper``: all subjects with numbers that the paper prints; ``all``: every subject. Both
        compare every printed number with ours, and write ``report.html`` and ``paper.json`` into the folder `out`.
    recordings
        Folder of real recordings, for the subjects that use them: ``recordings`` takes .npz, .npy, .csv and .mcap,
        ``single-wire`` a copy of github.com/aslepyan/SPTS.
    quick
        A look at everything in a small fraction of the time, with fewer steps and draws.
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) in place of the shapes that ship. Live rows of
        ``recognition`` that name objects keep these shapes.
    objects
        Comma-separated: what slides in ``rivals`` in place of the paper's five objects. Of these, or your own mesh as FILE@UNIT.
    out
        Folder for the report and for measured results, which a later run takes up. Default for ``all`` and ``paper``:
        skin-evaluation.
    jobs
        Processes at the same time. Default: one per core.
    draws
        Draws of Φ to average over. Default: each subject's own. ``settings``, ``sparsity``, ``figures``,
        ``rivals``, ``drawn-rivals``, ``calibration``,
        ``scaling`` average over none; ``all`` and ``paper`` hand them to the others.
    seed
        Of all random numbers but those that draw scenes.
    scenes
        Scenes drawn at random: the number of those of ``drawn-rivals``, and half the number of those that
        ``calibration`` measures beside the named ones; 2 and none with `quick`.
    scene_seed
        Of the scenes drawn at random: a seed that nobody has tried shows scenes that nobody has tuned to.
    basis
        Orthogonal wavelets that ``sparsity`` counts beside the paper's bases: ``sym4`` for Mallat's pyramid,
        ``sym4-tensor`` for the form of the paper's table.
    full_scale
        Recorded value that becomes the skin's largest force, for ``recordings``.
    rate
        Frames per second of the recordings, for ``recordings``; default: 10.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate all --quick
    skin evaluate all --meshes ycb-meshes --out report
    skin evaluate rivals --objects handle.stl@mm:y90,cup
    skin evaluate sparsity --basis sym4-tensor coif1-tensor
    skin evaluate recordings mats/ --full-scale 4095 --rate 25
    """
    from evaluation.result import Options
    from reconstructor.bases.names import wavelet_basis_name
    from touch.trajectory import checked_slides

    names = _names(subject)
    _check(
        subject,
        names,
        draws,
        has_recordings=recordings is not None,
        has_scenes=scenes > 0 or quick,
        basis=basis,
        objects=objects,
        of_recordings={"--full-scale": full_scale, "--rate": rate},
    )
    if out is None and len(names) > 1:
        out = Path("skin-evaluation")
    processes = jobs if jobs is not None else os.cpu_count() or 1
    bases = tuple(map(wavelet_basis_name, basis or ()))
    options = Options(quick, meshes, recordings, out, processes, draws, seed, scenes, scene_seed, bases)
    options = replace(options, full_scale=full_scale, frame_rate_hz=rate)
    if objects is not None:
        options = replace(options, objects=checked_slides(objects))
    results: dict[str, Result] = {}
    for name in names:
        asked = options if SUBJECTS[name].draws else replace(options, draws=None)
        module, _, function = SUBJECTS[name].function.partition(":")
        found = results[name] = getattr(import_module(module), function)(asked)
        if not found.rows and subject != "all":
            raise InputError(f"'{subject}' measured nothing: {found.note or found.title}")
        if not json:
            _print(found)
    if len(names) > 1:
        results = {"paper": _compare(results, options, subject), **results}
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
    if subject == "paper":
        from evaluation.reached import SUBJECTS as PRINTED

        return [name for name in SUBJECTS if name in PRINTED]
    return list(SUBJECTS) if subject == "all" else [subject]


def _check(
    subject: Subject,
    names: Sequence[str],
    draws: int | None,
    *,
    has_recordings: bool,
    has_scenes: bool,
    basis: list[str] | None,
    objects: str | None,
    of_recordings: Mapping[str, float | None],
) -> None:
    """Raise InputError for an option that is missing or that no subject takes."""
    if subject in RECORDED and not has_recordings:
        raise InputError(f"{subject} needs {RECORDED[subject]}: give the folder, skin evaluate {subject} DIR")
    if subject == "drawn-rivals" and not has_scenes:
        raise InputError("drawn-rivals needs --scenes of 1 or more: got 0")
    if draws is not None and not any(SUBJECTS[name].draws for name in names):
        raise InputError(f"'{subject}' averages over no draws of Φ, got {draws} draws: leave out --draws")
    if basis and "sparsity" not in names:
        raise InputError(f"only 'sparsity' takes bases, not '{subject}': leave out --basis")
    if objects is not None and not any(SUBJECTS[name].objects for name in names):
        takers = ", ".join(name for name, each in SUBJECTS.items() if each.objects)
        raise InputError(f"'{subject}' takes no objects, expected one of {takers}, got --objects {objects}")
    for flag, value in of_recordings.items():
        if value is not None and "recordings" not in names:
            raise InputError(f"only 'recordings' takes {flag}, not '{subject}': leave out {flag}")


def _print(found: "Result") -> None:
    print_table(list(found.rows[0]) if found.rows else [], map(dict.values, found.rows), title=found.title)
    print(f"{found.note}\n" if found.note else "")


def _compare(results: "dict[str, Result]", options: "Options", subject: str) -> "Result":
    """Compare every number that the paper prints with ours, and keep the comparison."""
    from evaluation import reached

    kept = reached.stored({name: found.rows for name, found in results.items()}, options, subject)
    if options.out is not None:
        reached.write(kept, options.out / reached.FILE)
    return reached.result(kept.numbers)
