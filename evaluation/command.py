"""``skin evaluate``: the paper's tables and figures made again, and what goes beyond them."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, get_args

from cyclopts import Parameter

from canskin.errors import InputError
from shell.parallel import Cluster
from shell.terminal import Json, print_json, print_table

if TYPE_CHECKING:
    from evaluation.result import Options, Result

#: The parts of the paper, in the order of the report.
Part = Literal["settings", "sparsity", "compression", "iterations", "figures", "classification"]
#: Folder of the report of all parts.
REPORT: Final = Path("skin-evaluation")


@Parameter(name="*")
@dataclass(frozen=True)
class RunOptions:
    """How an evaluation runs.

    Attributes
    ----------
    quick
        A look at everything in a small fraction of the time.
    out
        Folder for the report and for measured results, which a later run takes up.
    jobs
        Processes at the same time. Default: one per core.
    seed
        Of all random numbers but those that draw scenes.
    cluster
        In place of `jobs`.
    """

    quick: bool = False
    out: Path | None = None
    jobs: int | None = None
    seed: int = 0
    cluster: Cluster = None

    def options(self, **given: object) -> "Options":
        """Return these options with those of a subject."""
        from evaluation.result import Options

        jobs = self.cluster or (self.jobs if self.jobs is not None else os.cpu_count() or 1)
        return Options(quick=self.quick, out=self.out, jobs=jobs, seed=self.seed, **given)  # type: ignore[arg-type]


RUN: Final = RunOptions()


def paper(
    *parts: Part,
    meshes: Path | None = None,
    draws: int | None = None,
    run: RunOptions = RUN,
    json: Json = False,
) -> None:
    """Make tables and figures of the paper again and print ours beside the paper's numbers.

    With all parts every number that the paper prints is compared with ours, and ``report.html`` and ``paper.json`` are
    written into the folder `out`, by default skin-evaluation.

    Parameters
    ----------
    parts
        Default: all.
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) in place of the shapes that ship.
    draws
        Draws of Φ to average over. Default: each part's own.
    run
        How it runs.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate paper --quick
    skin evaluate paper --meshes ycb-meshes --out report
    skin evaluate paper compression iterations --draws 3 --json
    """
    from evaluation import reached, settings
    from evaluation.paper import figures, sparsity, tables
    from evaluation.recognition import classification
    from evaluation.result import write_text

    evaluators = {
        "settings": settings.evaluate,
        "sparsity": sparsity.evaluate,
        "compression": tables.compression,
        "iterations": tables.iterations,
        "figures": figures.evaluate,
        "classification": classification.evaluate,
    }
    out = run.out if run.out is not None or parts else REPORT
    options = RunOptions(run.quick, out, run.jobs, run.seed, run.cluster).options(meshes=meshes, draws=draws)
    results = {name: evaluators[name](options) for name in get_args(Part) if name in (parts or evaluators)}
    if not parts and out is not None:
        kept = reached.stored({name: found.rows for name, found in results.items()}, options)
        write_text(out / reached.FILE, reached.encoded(kept))
        results = {"paper": reached.result(kept.numbers), **results}
    _show(results, options, as_json=json)


def rivals(
    *,
    meshes: Path | None = None,
    objects: str | None = None,
    scenes: int = 10,
    scene_seed: int | None = None,
    run: RunOptions = RUN,
    json: Json = False,
) -> None:
    """Measure our sums against scans, coarse arrays and events of the same boards.

    Parameters
    ----------
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) in place of the shapes that ship.
    objects
        Comma-separated: what slides in place of the paper's five objects. Of these, or your own mesh as FILE@UNIT.
    scenes
        Number of scenes drawn at random; 2 with `quick`.
    scene_seed
        Show scenes drawn at random: a seed that nobody has tried shows scenes that nobody has tuned to.
    run
        How it runs.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate rivals --objects handle.stl@mm:y90,cup
    skin evaluate rivals --scene-seed 71
    """
    from evaluation.schemes.comparison import evaluate
    from touch.trajectory import checked_slides

    if objects is not None and scene_seed is not None:
        raise InputError(f"drawn scenes have no objects to choose, got --objects {objects}: leave it out")
    slides = {} if objects is None else {"objects": checked_slides(objects)}
    options = run.options(meshes=meshes, scenes=scenes, scene_seed=scene_seed, **slides)
    _show({"rivals": evaluate(options)}, options, as_json=json)


def recognition(
    *, meshes: Path | None = None, draws: int | None = None, run: RunOptions = RUN, json: Json = False
) -> None:
    """Measure chosen rows, steps, and the live service, which go beyond the paper's classifier.

    Parameters
    ----------
    meshes
        Folder of meshes in place of the shapes that ship; live rows that name objects keep these shapes.
    draws
        Draws of Φ to average over.
    run
        How it runs.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate recognition --quick
    skin evaluate recognition --meshes ycb-meshes
    """
    from evaluation.recognition.beyond import evaluate

    options = run.options(meshes=meshes, draws=draws)
    _show({"recognition": evaluate(options)}, options, as_json=json)


def calibration(*, scenes: int = 10, scene_seed: int | None = None, run: RunOptions = RUN, json: Json = False) -> None:
    """Measure what a skin shows while its zero drifts, scene by scene.

    Parameters
    ----------
    scenes
        Half the number of scenes drawn at random beside the named ones; none with `quick`.
    scene_seed
        Of these scenes; default 0.
    run
        How it runs.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate calibration --quick
    skin evaluate calibration --scene-seed 71
    """
    from evaluation.schemes.zero_scenes import evaluate

    options = run.options(scenes=scenes, scene_seed=scene_seed)
    _show({"calibration": evaluate(options)}, options, as_json=json)


def single_wire(recordings: Path, *, run: RunOptions = RUN, json: Json = False) -> None:
    """Solve sums that other hardware made, by our solver and by its authors' method.

    Parameters
    ----------
    recordings
        A copy of github.com/aslepyan/SPTS.
    run
        How it runs.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate single-wire SPTS --quick
    skin evaluate single-wire SPTS --json
    """
    from evaluation.single_wire import evaluate

    options = run.options(recordings=recordings)
    _show({"single-wire": evaluate(options)}, options, as_json=json)


def _show(results: "Mapping[str, Result]", options: "Options", *, as_json: bool) -> None:
    """Print the results, and write the report if there is a folder for it."""
    if not as_json:
        for found in results.values():
            print_table(list(found.rows[0]) if found.rows else [], map(dict.values, found.rows), title=found.title)
            print(f"{found.note}\n" if found.note else "")
    if options.out is not None:
        from evaluation.report import write_report

        print(f"report: {write_report(results, options, options.out)}", file=sys.stderr)
    if as_json:
        rows = [{"subject": name, **row} for name, found in results.items() for row in found.rows]
        print_json({"rows": rows, "notes": [found.note for found in results.values() if found.note]})
