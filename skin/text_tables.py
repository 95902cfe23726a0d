"""Tables of numbers in text files of others: usual separators, decimal commas, and units in the names of columns."""

import csv
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import LayoutError, SkinError
from skin.limits import read_text

#: Largest number of a taxel, board or place.
MOST: Final = int(np.iinfo(np.uint16).max)
#: Most columns of a file.
_COLUMNS_MAX: Final = 16
#: Metres and seconds of each unit, by the unit in which a column is known here.
_UNITS: Final = {
    **dict.fromkeys(("m", "s"), 1.0),
    "cm": 1e-2,
    **dict.fromkeys(("mm", "ms"), 1e-3),
    **dict.fromkeys(("um", "µm", "us", "µs"), 1e-6),
    "ns": 1e-9,
}
#: ``x_mm``, ``x [mm]``, ``x (mm)``, ``x / mm``.
_WITH_UNIT: Final = re.compile(rf"(\w+?)(?:_| *[\[(/] *)({'|'.join(_UNITS)})[\])]?")
#: Lines that are no part of the table: comments, and what a spreadsheet is told.
_NO_ROW: Final = re.compile(r"\s*(?:#.*|sep=.*)?\s*")


class Row(NamedTuple):
    """A line of a table: its file and number, and the text of each column; numbers have a decimal point."""

    where: str
    values: Mapping[str, str]


class Table(NamedTuple):
    """A table with a header.

    Attributes
    ----------
    columns : dict
        What a value of each column is multiplied by, by the name of the column: ``x_m`` of ``x [mm]``.
    rows : list of Row
    """

    columns: Mapping[str, float]
    rows: list[Row]

    def numbers(self, row: Row, names: Sequence[str]) -> list[float]:
        """Return the values of some columns in metres, seconds or as they are; LayoutError if one is no number."""
        try:
            return [float(row.values[name]) * self.columns[name] for name in names]
        except ValueError as error:
            raise LayoutError(f"{row.where}: expected numbers: {error}") from error


def read_table(path: Path, what: str, wanted: Sequence[str]) -> Table:
    """Read a CSV file with a header; other columns than those that are wanted are left out.

    Raises
    ------
    LayoutError
        If the file cannot be read, or a line has more or fewer values than the header, as with decimal commas between
        commas.
    """
    text = read_text(path, LayoutError, f"the {what}")
    separator = _separator(text)
    lines = csv.reader(StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
    cells_of_lines = _cells(lines)
    try:
        _, header = next(cells_of_lines, (1, []))
        # Not read beyond a header that is too long: the lines below would be as long.
        found = list(islice(cells_of_lines, MOST + 2)) if len(header) <= _COLUMNS_MAX else []
    except csv.Error as error:
        raise LayoutError(f"{path}: cannot read the {what}: {error}") from error
    if len(header) > _COLUMNS_MAX or len(found) > MOST + 1:
        raise LayoutError(f"{path}: expected at most {_COLUMNS_MAX} columns and {MOST + 1} lines, got more")
    names, scales = zip(*map(_named, header), strict=True) if header else ((), ())
    if twice := [name for name in wanted if names.count(name) > 1]:
        raise LayoutError(f"{path}: expected each column once, got {twice[0]} twice")
    rows = []
    for number, cells in found:
        where = f"{path}, line {number}"
        if len(cells) < len(names) or any(cells[len(names) :]):
            advice = "; decimal commas need ';' between the values" if len(cells) > len(names) else ""
            raise LayoutError(f"{where}: expected {len(names)} values, as in the header, got {len(cells)}{advice}")
        texts = cells if separator == "," else [each.replace(",", ".") for each in cells]
        rows.append(Row(where, dict(zip(names, texts, strict=False))))
    return Table(dict(zip(names, scales, strict=True)), rows)


def read_numbers(path: Path, kind: type[SkinError], what: str) -> npt.NDArray[np.float64]:
    """Return the numbers of a CSV file without a header, shape (lines, columns); raise `kind` if it is none."""
    text = read_text(path, kind, what)
    separator = _separator(text)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # what NumPy says of a file without lines
            decimal = text if separator == "," else text.replace(",", ".")
            return np.loadtxt(StringIO(decimal), np.float64, delimiter=separator, ndmin=2)
    except (ValueError, UserWarning) as error:
        got = error if text.strip() else "the file is empty"
        raise kind(f"{path}: cannot read {what}: expected lines of numbers: {got}") from error


def _separator(text: str) -> str:
    """Return what separates the values of the first line."""
    first = next((line for line in StringIO(text) if not _NO_ROW.fullmatch(line)), "")
    return next((each for each in ";\t" if each in first), ",")


def _cells(lines: Any) -> Iterator[tuple[int, list[str]]]:
    """Yield number and values of the lines that are rows."""
    for cells in lines:
        if any(cells) and not _NO_ROW.fullmatch(cells[0] + "".join(cells[1:])):
            yield lines.line_num, [each.strip() for each in cells]


def _named(header: str) -> tuple[str, float]:
    """Return the name of a column as it is known here, and what its values are multiplied by."""
    name = header.lower()
    if found := _WITH_UNIT.fullmatch(name):
        return f"{found[1]}_{found[2][-1]}", _UNITS[found[2]]
    return name, 1.0
