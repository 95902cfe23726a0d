"""Writes the made parts of ``docs/paper.md`` from ``docs/paper.json``, which a run of ``skin evaluate paper`` wrote.

``make paper`` writes them anew, ``make paper RESULTS=report/paper.json`` from another run, which then takes the place
of the one before.
"""

import re
import string
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

from canskin.errors import InputError
from evaluation.printed import Key
from evaluation.reached import VERDICTS, Compared, Stored, judged, read
from evaluation.result import grouped
from shell.output import write_file

DOCS: Final = Path(__file__).parent
DOCUMENT, RESULTS = DOCS / "paper.md", DOCS / "paper.json"
#: A part that is made, between comments of the document.
_PART: Final = re.compile(r"(<!-- made: (?P<name>[\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_NOT_REACHED, _, _WORSE, _ = VERDICTS


def run(stored: Stored) -> str:
    """Tell how the figures were made."""
    made = stored.made
    versions = ", ".join(f"{name} {number}" for name, number in made.versions.items())
    return f"Made by `{made.command}` on {made.date}, seed {made.seed}, with {versions}.\n"


def counts(stored: Stored) -> str:
    """Count the numbers of each place by verdict."""
    rows = [{"where": each.number.where, "verdict": each.verdict} for each in judged(stored.numbers)]
    places = [(str(where), group) for (where,), group in sorted(grouped(rows, "where").items())]
    lines = [
        [where, len(group), *(sum(row["verdict"] == verdict for row in group) for verdict in VERDICTS)]
        for where, group in [*places, ("all", rows)]
    ]
    return _table(["place", "numbers", *VERDICTS], lines)


def not_reached(stored: Stored) -> str:
    """List what is not reached, and the causes."""
    found = [each for each in judged(stored.numbers) if each.verdict == _NOT_REACHED]
    causes = list(dict.fromkeys(each.cause for each in found))
    letters = dict(zip(causes, string.ascii_lowercase, strict=False))
    rows = [[each.number.name, _unit(each), _ours(each), letters[each.cause]] for each in found]
    table = _table(["number", "paper", "ours", "cause"], rows)
    return table + "\n" + "".join(f"* **{letter}**: {cause}.\n" for cause, letter in letters.items())


def worse(stored: Stored) -> str:
    """Sum up what is worse than printed, within the tolerance."""
    found = [each for each in judged(stored.numbers) if each.verdict == _WORSE]
    groups: dict[tuple[str, ...], list[Compared]] = {}
    for each in found:
        number = each.number
        fixed = (str(number.cell[key]) for key in ("matrix", "basis") if key in number.cell)
        groups.setdefault((number.where, *fixed, number.quantity), []).append(each)
    rows = []
    for name, group in groups.items():
        worst = max(group, key=lambda each: each.short)
        rows.append([", ".join(name), len(group), f"{worst.short:.3g} {worst.rule.unit}", f"{worst.tolerance:.3g}"])
    return _table(["numbers", "count", "largest difference", "tolerance there"], rows)


def table_one(stored: Stored) -> str:
    """Lay out the means of Table I."""
    return _pivot(stored, "Table I", ("basis",), ("object",))


def table_two(stored: Stored) -> str:
    """Lay out the means of Table II."""
    return _pivot(stored, "Table II", ("object", "matrix"), ("basis", "sums"))


def table_three(stored: Stored) -> str:
    """Lay out the means of Table III."""
    return _pivot(stored, "Table III", ("object",), ("basis", "iterations"))


#: What makes each part of the document.
PARTS: Final[dict[str, Callable[[Stored], str]]] = {
    "run": run,
    "not-reached": not_reached,
    "worse": worse,
    "counts": counts,
    "table-1": table_one,
    "table-2": table_two,
    "table-3": table_three,
}


def made(document: str, stored: Stored) -> str:
    """Return a document with its parts made anew."""
    return _PART.sub(lambda part: f"{part[1]}\n{PARTS[part['name']](stored)}\n{part[3]}", document)


def _pivot(stored: Stored, where: str, down: Sequence[str], across: Sequence[str]) -> str:
    """Return a table of means, ours and the paper's in brackets."""
    cells: dict[tuple[Key, ...], dict[tuple[Key, ...], str]] = {}
    for each in judged(stored.numbers):
        number = each.number
        if number.where == where and number.quantity == "mean" and all(key in number.cell for key in (*down, *across)):
            row = cells.setdefault(tuple(number.cell[key] for key in down), {})
            row[tuple(number.cell[key] for key in across)] = f"{each.ours:.1f} ({number.value:.1f})"
    columns = sorted({column for row in cells.values() for column in row}, key=lambda each: (each[0], -_count(each)))
    rows = [[*name, *(row[column] for column in columns)] for name, row in sorted(cells.items())]
    return _table([*down, *(" ".join(map(str, column)) for column in columns)], rows)


def _count(column: Sequence[Key]) -> float:
    return float(column[-1]) if isinstance(column[-1], int | float) else 0.0


def _unit(each: Compared) -> str:
    return f"{each.number.value:g} {each.rule.unit}".rstrip()


def _ours(each: Compared) -> str:
    return f"{each.ours:.4g}" + (f" ± {each.spread:.2g}" if each.spread is not None else "")


def _table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def _whole(path: Path) -> Stored:
    stored = read(path)
    if missing := [each.number.name for each in judged(stored.numbers) if each.ours is None]:
        raise InputError(f"'{path}' lacks numbers: {len(missing)}, such as {missing[0]}; give a whole run")
    return stored


def main(arguments: Sequence[str]) -> int:
    """Write the document; return the exit status."""
    path = Path(arguments[0]) if arguments else RESULTS
    try:
        stored = _whole(path)
    except InputError as error:
        print(f"paper: {error}", file=sys.stderr)
        return 2
    if arguments:
        write_file(RESULTS, Path(arguments[0]).read_text(encoding="utf-8"))
    write_file(DOCUMENT, made(DOCUMENT.read_text(encoding="utf-8"), stored))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
