"""``skin evaluate``: the paper's tables and figures made again, and what goes beyond them."""

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, NamedTuple

from cyclopts import Parameter

from canskin.errors import InputError
from shell.terminal import Json, print_json, print_table
from shell.touch_options import FullScale

if TYPE_CHECKING:
    from evaluation.result import Result

Subject = Literal[
    "all",
    "claims",
    "sparsity",
    "compression",
    "iterations",
    "figures",
    "solvers",
    "noiselets",
    "rivals",
    "drawn-rivals",
    "rates",
    "contacts",
    "calibration",
    "offsets",
    "wiring",
    "frontend",
    "scaling",
    "classification",
    "recognition",
    "postures",
    "single-wire",
    "recordings",
]


class _Subject(NamedTuple):
    """Where the function ``options -> Result`` of a subject is, and whether it averages over draws of Φ."""

    function: str
    draws: bool = False


#: In the order of the report.
SUBJECTS: Final[dict[str, _Subject]] = {
    "claims": _Subject("evaluation.claims:evaluate", draws=True),
    "sparsity": _Subject("evaluation.paper.sparsity:evaluate"),
    "compression": _Subject("evaluation.paper.tables:compression", draws=True),
    "iterations": _Subject("evaluation.paper.tables:iterations", draws=True),
    "figures": _Subject("evaluation.paper.figures:evaluate"),
    "solvers": _Subject("evaluation.paper.solvers:evaluate"),
    "noiselets": _Subject("evaluation.paper.noiselets:evaluate"),
    "rivals": _Subject("evaluation.schemes.comparison:evaluate"),
    "drawn-rivals": _Subject("evaluation.schemes.comparison:evaluate_drawn"),
    "rates": _Subject("evaluation.schemes.rates:evaluate"),
    "contacts": _Subject("evaluation.schemes.contacts:evaluate"),
    "calibration": _Subject("evaluation.schemes.zero_scenes:evaluate"),
    "offsets": _Subject("evaluation.schemes.offsets:evaluate"),
    "wiring": _Subject("evaluation.schemes.wiring:evaluate"),
    "frontend": _Subject("evaluation.schemes.frontend:evaluate"),
    "scaling": _Subject("evaluation.schemes.scaling:evaluate"),
    "classification": _Subject("evaluation.recognition.classification:evaluate", draws=True),
    "recognition": _Subject("evaluation.recognition.methods_compared:evaluate", draws=True),
    "postures": _Subject("evaluation.recognition.postures:evaluate", draws=True),
    "single-wire": _Subject("evaluation.single_wire:evaluate"),
    "recordings": _Subject("evaluation.schemes.recordings:evaluate"),
}
#: Subjects that measure recordings alone, and the recordings that each needs.
RECORDED: Final = {
    "postures": "the recordings of a pressure mat",
    "single-wire": "a copy of github.com/aslepyan/SPTS",
    "recordings": "recordings of a pressure mat, glove or skin",
}


def evaluate(
    subject: Subject,
    recordings: Path | None = None,
    *,
    quick: bool = False,
    meshes: Path | None = None,
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
        What to evaluate; ``all`` writes ``report.html`` into the folder `out`.
    recordings
        Folder of real recordings, for the subjects that use them: ``recordings`` and ``rates`` take .npz, .npy, .csv
        and .mcap, ``postures`` S1.npz and so on, ``single-wire`` a copy of github.com/aslepyan/SPTS.
    quick
        A look at everything in a small fraction of the time, with fewer steps and draws.
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) in place of the shapes that ship. Live rows of
        ``claims`` and ``recognition`` that name objects keep these shapes.
    out
        Folder for the report and for measured results, which a later run takes up. Default for ``all``:
        skin-evaluation.
    jobs
        Processes at the same time. Default: one per core.
    draws
        Draws of Φ to average over. Default: each subject's own. ``sparsity``, ``figures``, ``solvers``, ``noiselets``,
        ``rivals``, ``drawn-rivals``, ``rates``, ``contacts``, ``calibration``, ``offsets``, ``wiring``, ``frontend``
        and ``scaling`` average over none; ``all`` hands them to the others.
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
    skin evaluate sparsity --basis sym4-tensor coif1-tensor
    skin evaluate recordings mats/ --full-scale 4095 --rate 25
    """
    from evaluation.result import Options
    from reconstructor.bases.names import wavelet_basis_name

    _check(subject, recordings, draws, basis, {"--full-scale": full_scale, "--rate": rate})
    if not scenes and not quick and subject == "drawn-rivals":
        raise InputError("drawn-rivals needs --scenes of 1 or more: got 0")
    if out is None and subject == "all":
        out = Path("skin-evaluation")
    processes = jobs if jobs is not None else os.cpu_count() or 1
    bases = tuple(map(wavelet_basis_name, basis or ()))
    options = Options(
        quick, meshes, recordings, out, processes, draws, seed, scenes, scene_seed, bases, full_scale, rate
    )
    results: dict[str, Result] = {}
    for name in SUBJECTS if subject == "all" else [subject]:
        asked = options if SUBJECTS[name].draws else replace(options, draws=None)
        module, _, function = SUBJECTS[name].function.partition(":")
        found = results[name] = getattr(import_module(module), function)(asked)
        if not found.rows and subject != "all":
            raise InputError(f"'{subject}' measured nothing: {found.note or found.title}")
        if not json:
            print_table(list(found.rows[0]) if found.rows else [], map(dict.values, found.rows), title=found.title)
            print(f"{found.note}\n" if found.note else "")
    if out is not None:
        from evaluation.report import write_report

        print(f"report: {write_report(results, options, out)}", file=sys.stderr)
    if json:
        rows = [{"subject": name, **row} for name, found in results.items() for row in found.rows]
        print_json({"rows": rows, "notes": [found.note for found in results.values() if found.note]})


def _check(
    subject: Subject,
    recordings: Path | None,
    draws: int | None,
    basis: list[str] | None,
    of_recordings: Mapping[str, float | None],
) -> None:
    """Raise InputError for options that a subject lacks, or does not take."""
    if subject in RECORDED and recordings is None:
        raise InputError(f"{subject} needs {RECORDED[subject]}: give the folder, skin evaluate {subject} DIR")
    if draws is not None and subject != "all" and not SUBJECTS[subject].draws:
        raise InputError(f"'{subject}' averages over no draws of Φ, got {draws} draws: leave out --draws")
    if basis and subject not in {"all", "sparsity"}:
        raise InputError(f"only 'sparsity' takes bases, not '{subject}': leave out --basis")
    for flag, value in of_recordings.items():
        if value is not None and subject not in {"all", "recordings"}:
            raise InputError(f"only 'recordings' takes {flag}, not '{subject}': leave out {flag}")
