"""A layout as the TOML text that makes it, for layouts that were searched and not written by hand."""

from typing import Any

import msgspec

from skin.layout import Layout


def layout_text(layout: Layout) -> str:
    """Return TOML that `skin.layout.parse_layout` reads as the same layout."""
    tables: dict[str, Any] = msgspec.to_builtins(layout)
    lines = [
        f"{key} = {_value(tables.pop(key))}" for key in [k for k, v in tables.items() if not isinstance(v, dict | list)]
    ]
    for key, table in tables.items():
        for each in table if isinstance(table, list) else [table]:
            lines += ["", f"[[{key}]]" if isinstance(table, list) else f"[{key}]"]
            lines += [f"{name} = {_value(value)}" for name, value in each.items() if value is not None]
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)
