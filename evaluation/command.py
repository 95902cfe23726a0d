"""``skin evaluate``: the paper's tables and figures made again, and what goes beyond them."""

import json as json_format
import os
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, get_args

from skin.errors import InputError

if TYPE_CHECKING:
    from evaluation.findings import Findings

Subject = Literal[
    "all",
    "sparsity",
    "compression",
    "iterations",
    "figures",
    "solvers",
    "rivals",
    "rates",
    "classification",
    "recognition",
    "postures",
]
#: Where each subject's ``evaluate(options) -> Findings`` lives, in the order of the report.
SUBJECTS: Final[dict[str, str]] = {
    "sparsity": "evaluation.paper.sparsity",
    "compression": "evaluation.paper.compression",
    "iterations": "evaluation.paper.iterations",
    "figures": "evaluation.paper.figures",
    "solvers": "evaluation.paper.solvers",
    "rivals": "evaluation.schemes.rivals",
    "rates": "evaluation.schemes.rates",
    "classification": "evaluation.recognition.classification",
    "recognition": "evaluation.recognition.beyond",
    "postures": "evaluation.recognition.postures",
}

#: Subjects that average over no draws of Φ: of ``all``, draws are for the others.
_WITHOUT_DRAWS: Final = ("sparsity", "figures", "solvers", "rivals", "rates")


def evaluate(
    subject: Subject,
    *,
    quick: bool = False,
    meshes: Path | None = None,
    recordings: Path | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    draws: int | None = None,
    seed: int = 0,
    json: bool = False,
) -> None:
    """Make tables and figures of the paper again and print ours beside the paper's numbers.

    Parameters
    ----------
    subject
        What to evaluate; ``all`` writes ``report.html`` into the folder `out`.
    quick
        A look at everything in a small fraction of the time, with fewer steps and draws.
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) in place of the shapes that ship.
    recordings
        Folder of real pressure recordings (S1.npz and so on), for the parts that use them.
    out
        Folder for the report and for measured results, which a later run takes up. Default for ``all``:
        skin-evaluation.
    jobs
        Processes at the same time. Default: one per core.
    draws
        Draws of Φ to average over. Default: each subject's own. ``sparsity``, ``figures``, ``solvers``, ``rivals`` and
        ``rates`` average over none; ``all`` hands them to the others.
    seed
        Of all random numbers.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin evaluate all --quick
    skin evaluate all --meshes ycb-meshes --out report
    """
    from evaluation.findings import Options

    if subject not in get_args(Subject):
        raise InputError(f"unknown subject '{subject}': expected one of {', '.join(get_args(Subject))}")
    if subject == "postures" and recordings is None:
        raise InputError("postures needs the recordings of a pressure mat: give their folder with --recordings")
    if out is None and subject == "all":
        out = Path("skin-evaluation")
    processes = jobs if jobs is not None else os.cpu_count() or 1
    options = Options(quick, meshes, recordings, out, processes, draws, seed)
    findings = {}
    for name in SUBJECTS if subject == "all" else [subject]:
        asked = replace(options, draws=None) if subject == "all" and name in _WITHOUT_DRAWS else options
        findings[name] = import_module(SUBJECTS[name]).evaluate(asked)
        if not json:
            _print(findings[name])
    if out is not None:
        from evaluation.report import write_report

        print(f"report: {write_report(findings, options, out)}", file=sys.stderr)
    if json:
        _dump(findings)


def _dump(findings: "dict[str, Findings]") -> None:
    rows = [{"subject": name, **row} for name, found in findings.items() for row in found.rows]
    notes = [note for found in findings.values() for note in found.notes]
    json_format.dump({"rows": rows, "notes": notes}, sys.stdout)
    print()


def _print(found: "Findings") -> None:
    from rich.console import Console
    from rich.table import Table

    # Without a terminal rich takes 80 columns, which cuts off the names of columns.
    console = Console(file=sys.stdout, width=None if sys.stdout.isatty() else 200)
    table = Table(*(found.rows[0] if found.rows else ()), title=found.title)
    for row in found.rows:
        table.add_row(*("" if value is None else str(value) for value in row.values()))
    console.print(table)
    for note in found.notes:
        console.print(f"- {note}", highlight=False, markup=False)
