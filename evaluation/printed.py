"""The numbers that the paper prints, from ``printed.toml``: value, place, tolerance, and where ours is found.

Objects and bases have the names of `touch.trajectory` and of `evaluation.paper`.
"""

from functools import cache
from importlib.resources import files
from typing import Final, Literal, NamedTuple

import msgspec

Matrix = Literal["sbhe", "noiselet"]
BasisName = Literal["haar", "contourlet"]
#: What a row has in a column: whole numbers stay whole.
Key = str | int | float
#: Value of the column ``matrix`` where all taxels are sent, with their noise.
SENSOR: Final = "none: sensor signal"
#: A key of a table that is no key of our rows: the place of a number.
_PLACE: Final = "where"


class Psnr(NamedTuple):
    """Mean, least and largest PSNR over the 4200 steps of a trajectory, dB."""

    mean: float
    least: float
    most: float


class Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When a number counts as reached: at most `tolerance` worse than printed, of the number if `percent`."""

    unit: str
    better: Literal["more", "less", "equal"]
    tolerance: float
    why: str
    percent: bool = False


class Number(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A printed number, and the row and column of ``skin evaluate paper SUBJECT`` that has ours.

    Attributes
    ----------
    where, quantity : str
        Place in the paper, and what the number is of.
    value : float
        As printed, in the unit of its rule.
    rule : str
        Key of `Printed.rule`.
    subject, cell, column : str, dict, str
        Ours: the subject, what its row has in other columns, and the column.
    spread : str
        Column of the standard deviation, empty where there is none.
    minus : dict
        Cell of the row that ours is less, empty where ours is of one row.
    divided_by : float
        Ours is divided by this.
    """

    where: str
    quantity: str
    value: float
    rule: str
    subject: str
    cell: dict[str, Key]
    column: str = "ours"
    spread: str = ""
    minus: dict[str, Key] = {}
    divided_by: float = 1.0

    @property
    def name(self) -> str:
        """Place, cell of a table, and quantity, as one line."""
        cell = map(str, self.cell.values()) if self.where.startswith("Table") else ()
        return ", ".join(dict.fromkeys((self.where, *cell, self.quantity)))


class Cause(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Why ours does not reach numbers: all whose name has each of `of`."""

    of: list[str]
    words: str


class _Column(msgspec.Struct, forbid_unknown_fields=True):
    quantity: str
    rule: str
    column: str = "ours"
    spread: str = ""
    cell: dict[str, Key] = {}


class _Table(msgspec.Struct, forbid_unknown_fields=True):
    where: str
    subject: str
    cell: dict[str, Key]
    keys: list[str]
    columns: list[_Column]
    rows: list[list[Key]]

    def numbers(self) -> list[Number]:
        found = []
        for row in self.rows:
            named = dict(zip(self.keys, row, strict=False))
            where = str(named.pop(_PLACE, self.where))
            for each, value in zip(self.columns, row[len(self.keys) :], strict=True):
                found.append(
                    Number(
                        where=where,
                        quantity=each.quantity or str(row[len(self.keys) - 1]),
                        value=float(value),
                        rule=each.rule,
                        subject=self.subject,
                        cell={**self.cell, **named, **each.cell},
                        column=each.column,
                        spread=each.spread,
                    )
                )
        return found


class _File(msgspec.Struct, forbid_unknown_fields=True):
    rule: dict[str, Rule]
    text: list[Number]
    table: list[_Table]
    cause: list[Cause]


class Printed(NamedTuple):
    """What ``printed.toml`` says; `numbers` in the order of the file, those of tables first."""

    rule: dict[str, Rule]
    numbers: tuple[Number, ...]
    causes: tuple[Cause, ...]


@cache
def printed() -> Printed:
    """Return what ``printed.toml`` says."""
    content = msgspec.toml.decode(files(__package__).joinpath("printed.toml").read_bytes(), type=_File)
    of_tables = [number for table in content.table for number in table.numbers()]
    return Printed(content.rule, (*of_tables, *content.text), tuple(content.cause))


@cache
def _values() -> dict[tuple[object, ...], float]:
    found: dict[tuple[object, ...], float] = {}
    for each in printed().numbers:
        if not each.minus and each.divided_by == 1:
            found.setdefault((each.subject, each.column, frozenset(each.cell.items())), each.value)
    return found


def paper_value(subject: str, column: str = "ours", **cell: Key) -> float | None:
    """Return the first number printed for a cell of a subject, None where the paper has none."""
    return _values().get((subject, column, frozenset(cell.items())))


def printed_value(subject: str, column: str = "ours", **cell: Key) -> float:
    """Return the first number printed for a cell of a subject; raise KeyError where the paper has none."""
    return _values()[subject, column, frozenset(cell.items())]


def paper_psnr(subject: str, **cell: Key) -> Psnr:
    """Return the PSNR printed for a cell of a subject; raise KeyError where the paper has none."""
    return Psnr(*(printed_value(subject, column, **cell) for column in ("ours", "least", "most")))


def sensor_psnr(name: str) -> Psnr:
    """Return the PSNR printed for the sensor signal of an object."""
    return paper_psnr("compression", object=name, matrix=SENSOR)
