"""``skin config``: every setting of a skin and of this environment, and where its value comes from."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from bus.protocol import runtime_folder
from recording import is_recording
from shell.output import cache_folder
from shell.skin_options import SkinOptions
from shell.terminal import Json, print_json, print_table
from skin.layout import layout_tables
from views.ros2.names import check_domain

DEFAULT: Final = "default"
DERIVED: Final = "from other keys"
#: Most characters of a value in the table; JSON has all.
_CHARACTERS: Final = 60


class Setting(NamedTuple):
    """A setting; `origin` is the file, the hub, an environment variable, `DEFAULT` or `DERIVED`."""

    key: str
    value: Any
    origin: str


def config(recording: Path | None = None, *, of: SkinOptions | None = None, json: Json = False) -> None:
    """Print the layout with all defaults, the settings of the environment, and where each value comes from.

    A value of an option of a verb comes before that of the environment, and that before the layout's.

    Parameters
    ----------
    recording
        A recording (.mcap): its layout.
    of
        Which skin; without an option the default skin.
    json
        Print one JSON object.

    Examples
    --------
    skin config --layout palm.toml
    skin config run.mcap
    skin config --connect tcp/10.0.0.5:7447
    """
    of = of or SkinOptions()
    layout = of.find(recording=recording, needs_hub=False)
    path = of.layout or (recording if is_recording(recording) else None)
    if path is None and (of.connect or of.skin):
        given, origin = msgspec.to_builtins(layout), f"hub {of.endpoint}"
    else:
        given, origin = layout_tables(path)
    found = [*_settings(layout, given, origin), *_environment()]
    if json:
        print_json([each._asdict() for each in found])
    else:
        print_table(["setting", "value", "from"], ((each.key, _short(each.value), each.origin) for each in found))


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


def _environment() -> Iterator[Setting]:
    """Yield what the verbs take from the environment."""
    for key, value, names in (
        ("folder of virtual buses", str(runtime_folder()), ("SKIN_BUS_DIR", "XDG_RUNTIME_DIR")),
        ("cache folder", str(cache_folder()), ("SKIN_CACHE", "XDG_CACHE_HOME")),
        ("domain of ROS", check_domain(None), ("ROS_DOMAIN_ID",)),
    ):
        yield Setting(key, value, next((f"${name}" for name in names if os.environ.get(name)), DEFAULT))


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= _CHARACTERS else f"{text[:_CHARACTERS]}..."
