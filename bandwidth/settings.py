"""Every key of a layout with its value, and where the value comes from."""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import msgspec

from skin.layout import Layout

DEFAULT: Final = "default"
DERIVED: Final = "from other keys"


class Setting(NamedTuple):
    """A key of a layout; `origin` is the file, `DEFAULT` or `DERIVED`."""

    key: str
    value: Any
    origin: str


def settings(layout: Layout, given: dict[str, Any], origin: str) -> list[Setting]:
    """Return the settings of a layout; `given` are the tables in its file, `origin` is the name of the file."""
    return list(_settings(layout, given, origin))


def _settings(table: msgspec.Struct, given: Any, origin: str, path: str = "") -> Iterator[Setting]:
    """Yield the keys of a table of the layout, and of the tables in it; `given` is the table in the file."""
    given = given if isinstance(given, dict) else {}
    for field in msgspec.structs.fields(table):
        key, value = path + field.name, getattr(table, field.name)
        inside = given.get(field.encode_name)
        if isinstance(value, msgspec.Struct):
            yield from _settings(value, inside, origin, f"{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], msgspec.Struct):
            tables = inside if isinstance(inside, list) and len(inside) == len(value) else [None] * len(value)
            for place, (each, one) in enumerate(zip(value, tables, strict=True)):
                yield from _settings(each, one, origin, f"{key}[{place}].")
        elif value is not None:
            yield Setting(
                key, value, origin if inside is not None else DEFAULT if _is_default(field, value) else DERIVED
            )


def _is_default(field: Any, value: Any) -> bool:
    made = field.default_factory() if field.default_factory is not msgspec.NODEFAULT else field.default
    return bool(made == value)
