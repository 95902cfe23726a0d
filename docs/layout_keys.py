"""Writes default and range of each key of a layout, from the code, into the table of `docs/layout.md`.

``python -m docs.layout_keys`` keeps what the page says of each key.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from msgspec import NODEFAULT, inspect

from shell.output import write_file
from skin.layout import Layout

PAGE: Final = Path(__file__).with_name("layout.md")
#: Keys whose default follows from the others (`skin.choice`).
_CHOSEN: Final = {"measurement.sums", "sampling.rate_hz", "bus"}
#: Head of the table, which ends with an empty line.
_HEAD: Final = "| key | default; range | meaning |\n"
#: A row of the table: key, default and range, meaning.
_ROW: Final = re.compile(r"^\| `([a-z_.]+)` \| ([^|]*) \| (.*) \|$", re.MULTILINE)


def keys() -> dict[str, str]:
    """Return default and range of each key of a layout, in the order of the code."""
    return dict(_keys(inspect.type_info(Layout), ""))


def page(text: str) -> str:
    """Return the page with default and range of each key as the code has them.

    Raises
    ------
    ValueError
        If the page lacks a key, or has a key that is none.
    """
    before, head, rest = text.partition(_HEAD)
    rows, end, after = rest.partition("\n\n")
    known = keys()
    named = {found[1] for found in _ROW.finditer(rows)}
    if named != known.keys():
        raise ValueError(f"{PAGE.name}: a row is missing or needless for {', '.join(sorted(named ^ known.keys()))}")
    rows = _ROW.sub(lambda found: f"| `{found[1]}` | {known[found[1]]} | {found[3]} |", rows)
    return before + head + rows + end + after


def _keys(table: Any, prefix: str) -> Iterator[tuple[str, str]]:
    for field in table.fields:
        name, kind = prefix + field.encode_name, _without_none(field.type)
        held = _without_none(getattr(kind, "item_type", kind))
        if isinstance(held, inspect.StructType):
            if kind is not held:
                yield name, "chosen" if name in _CHOSEN else "none"
            yield from _keys(held, f"{name}.")
            continue
        default = "chosen" if name in _CHOSEN else _default(field)
        yield name, "; ".join(each for each in (default, _range(kind, default)) if each)


def _without_none(kind: Any) -> Any:
    """Return the type of a key that is given."""
    if isinstance(kind, inspect.UnionType):
        return next(each for each in kind.types if not isinstance(each, inspect.NoneType))
    return kind


def _default(field: Any) -> str:
    if field.required:
        return "required"
    value = field.default if field.default is not NODEFAULT else None
    return "none" if value is None else _shown(value)


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"`{value}`" if isinstance(value, str) else f"{value:.10g}"


def _range(kind: Any, default: str) -> str:
    """Return the values that a key may have beside its default."""
    if isinstance(kind, inspect.LiteralType):
        return ", ".join(each for each in map(_shown, kind.values) if each != default)
    if isinstance(kind, inspect.BoolType):
        return "true" if default == "false" else "false"
    if not isinstance(kind, inspect.IntType | inspect.FloatType):
        return "a list" if isinstance(kind, inspect.VarTupleType) else ""
    least = "" if kind.ge is None else _shown(kind.ge)
    if kind.le is not None:
        return f"{least} to {_shown(kind.le)}"
    return f"from {least}" if least else f"above {kind.gt:g}" if kind.gt is not None else ""


if __name__ == "__main__":
    write_file(PAGE, page(PAGE.read_text("utf-8")).encode())
