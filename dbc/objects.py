"""Objects of a dictionary as data, and the records and arrays that they make up."""

from collections.abc import Sequence
from typing import Final, Literal

import msgspec

from dbc import indices as od

Access = Literal["ro", "rw", "wo", "const"]
Value = int | float | str

HIGHEST_SUBINDEX: Final = "Highest sub-index supported"


class Object(msgspec.Struct, frozen=True):
    """One object: a variable, or with `subindex` one entry of the record or array called `group`."""

    index: int
    subindex: int | None
    name: str
    data_type: int
    access: Access
    value: Value
    pdo: bool = False
    group: str = ""
    array: bool = False


def mapping(number: int, count: int, mapped: list[int], access: Access = "rw") -> list[Object]:
    """Return the mapping record of TPDO `number`: `count` objects, and room for as many as `mapped` has."""
    index, group = od.TPDO_MAPPING + number - 1, f"TPDO {number} mapping parameter"
    return [
        Object(index, 0, "Number of mapped objects", od.UNSIGNED8, access, count, group=group),
        *(
            Object(index, place, f"Mapped object {place}", od.UNSIGNED32, access, entry, group=group)
            for place, entry in enumerate(mapped, 1)
        ),
    ]


def record(index: int, group: str, entries: Sequence[tuple[str, int, Access, Value]]) -> list[Object]:
    """Return sub-index 0 and the entries of a record: name, type, access, value."""
    return [
        Object(index, 0, HIGHEST_SUBINDEX, od.UNSIGNED8, "const", len(entries), group=group),
        *(
            Object(index, sub, name, kind, access, value, group=group)
            for sub, (name, kind, access, value) in enumerate(entries, 1)
        ),
    ]


def places(count: int) -> range:
    """Return the sub-indices of the entries of an array."""
    return range(1, count + 1)


def array(
    index: int,
    group: str,
    names: list[str],
    data_type: int,
    access: Access,
    *,
    value: Value | list[int] = 0,
    pdo: bool = False,
) -> list[Object]:
    """Return sub-index 0 and one entry per name; `value` is one value for all entries, or one per entry."""
    values = value if isinstance(value, list) else [value] * len(names)
    entries = [
        Object(index, place, name, data_type, access, each, pdo, group, array=True)
        for place, (name, each) in enumerate(zip(names, values, strict=True), 1)
    ]
    return [Object(index, 0, HIGHEST_SUBINDEX, od.UNSIGNED8, "const", len(names), group=group, array=True), *entries]
