"""Which of the numbers that the paper prints ours reach, and the file that keeps a run's comparison."""

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final, Literal, NamedTuple

import msgspec

from canskin.errors import UNDECODABLE, InputError
from evaluation.printed import Number, Rule, printed
from evaluation.result import Options, Result, Row
from evaluation.result_cache import LIBRARIES, code_digest
from skin.limits import TEXT_BYTES_MAX, read_file

Verdict = Literal["not reached", "not measured", "worse, within the tolerance", "reached"]
#: In the order in which they are shown.
VERDICTS: Final[tuple[Verdict, ...]] = ("not reached", "not measured", "worse, within the tolerance", "reached")
#: The file of a comparison in the folder of a report.
FILE: Final = "paper.json"


class Ours(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """Ours beside a printed number: None where it was not measured; `spread` is a standard deviation over draws."""

    number: str
    ours: float | None
    spread: float | None = None


class Made(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the numbers of a file were made."""

    command: str
    date: str
    seed: int
    versions: dict[str, str]
    code: str


class Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A comparison as kept: every printed number with ours."""

    made: Made
    numbers: list[Ours]


class Compared(NamedTuple):
    """A printed number beside ours. `short`: how much worse ours is, negative where it is better."""

    number: Number
    rule: Rule
    ours: float | None
    spread: float | None

    @property
    def short(self) -> float:
        """By how much ours, rounded as printed, is worse than the paper's."""
        value, digits = self.number.value, max(1, decimals(self.number.value))
        more = round(round(self.ours or 0.0, digits) - value, digits)
        return abs(more) if self.rule.better == "equal" else -more if self.rule.better == "more" else more

    @property
    def tolerance(self) -> float:
        """What may be short, in the unit of the number."""
        return self.rule.tolerance * (self.number.value / 100 if self.rule.percent else 1)

    @property
    def verdict(self) -> Verdict:
        """Whether ours reaches the number."""
        if self.ours is None:
            return "not measured"
        if self.short > self.tolerance + 1e-9:
            return "not reached"
        return "worse, within the tolerance" if self.short > 0 else "reached"

    @property
    def cause(self) -> str:
        """Why the number is not reached, empty where ``printed.toml`` has no cause."""
        name = self.number.name
        return next((each.words for each in printed().causes if all(part in name for part in each.of)), "")


def decimals(value: float) -> int:
    """Return the decimals of a number as it is printed."""
    return len(f"{value:.10f}".rstrip("0").partition(".")[2])


def compare(found: Mapping[str, Sequence[Row]]) -> list[Ours]:
    """Return ours for every printed number whose subject is in `found`: rows by subject."""
    return [_ours(each, found[each.subject]) for each in printed().numbers if each.subject in found]


def judged(stored: Sequence[Ours]) -> list[Compared]:
    """Return every printed number beside ours, by verdict: what is not reached comes first."""
    by_name = {each.number: each for each in stored}
    known = printed()
    every = [
        Compared(each, known.rule[each.rule], by_name[each.name].ours, by_name[each.name].spread)
        for each in known.numbers
        if each.name in by_name
    ]
    return sorted(every, key=lambda each: VERDICTS.index(each.verdict))


def result(stored: Sequence[Ours]) -> Result:
    """Return the comparison as a table, what is not reached first."""
    every = judged(stored)
    rows = [
        {
            "number": each.number.name,
            "unit": each.rule.unit,
            "ours": each.ours,
            "deviation": each.spread,
            "paper": each.number.value,
            "tolerance": round(each.tolerance, 3),
            "verdict": each.verdict,
            "cause": each.cause if each.verdict == "not reached" else "",
        }
        for each in every
    ]
    counts = ", ".join(f"{sum(each.verdict == verdict for each in every)} {verdict}" for verdict in VERDICTS)
    note = f"{len(every)} printed numbers: {counts}. Tolerances and their reasons: evaluation/printed.toml."
    return Result("Every number that the paper prints, and ours", rows, note=note)


def stored(found: Mapping[str, Sequence[Row]], options: Options) -> Stored:
    """Return what is kept of a run: its numbers from rows by subject, and how they were made."""
    given = {"--meshes": options.meshes and options.meshes.name, "--draws": options.draws, "--seed": options.seed}
    command = "skin evaluate paper" + "".join(f" {name} {value}" for name, value in given.items() if value)
    command += " --quick" if options.quick else ""
    versions = {name: version(name) for name in ("canskin", *LIBRARIES)}
    made = Made(command, datetime.now(UTC).date().isoformat(), options.seed, versions, code_digest())
    return Stored(made, compare(found))


def encoded(kept: Stored) -> str:
    """Return a comparison as JSON, a number a line."""
    encode = msgspec.json.encode
    numbers = ",\n".join(encode(each).decode() for each in kept.numbers)
    return f'{{\n"made":{encode(kept.made).decode()},\n"numbers":[\n{numbers}\n]\n}}\n'


def read(path: Path) -> Stored:
    """Return a comparison from a file of `encoded`; raise InputError if the file is none."""
    content = read_file(path, InputError, "the comparison", TEXT_BYTES_MAX)
    try:
        return msgspec.json.decode(content, type=Stored)
    except UNDECODABLE as error:
        raise InputError(f"'{path}' is no comparison of 'skin evaluate paper': {error}") from error


def _ours(number: Number, rows: Sequence[Row]) -> Ours:
    row = _row(rows, number.cell)
    if row is None or row[number.column] is None or not math.isfinite(row[number.column]):
        return Ours(number.name, None)
    ours = float(row[number.column])
    if number.minus:
        other = _row(rows, number.minus)
        if other is None:
            return Ours(number.name, None)
        ours -= float(other[number.column])
    spread = row[number.spread] if number.spread else None
    return Ours(number.name, round(ours / number.divided_by, 6), spread)


def _row(rows: Sequence[Row], cell: Mapping[str, object]) -> Row | None:
    """Return the row with all of `cell`, None where there is none; several are an error of ``printed.toml``."""
    found = [row for row in rows if all(row.get(key) == value for key, value in cell.items())]
    if len(found) > 1:
        raise ValueError(f"expected one row with {cell}, got {len(found)}")
    return found[0] if found else None
