"""Parts of generated C texts."""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

#: Mark of generated files.
WRITTEN: Final = "Written by `skin contract --firmware`: do not edit."
_PER_LINE: Final = 16


def array(kind: str, name: str, numbers: Iterable[object], *, per_line: int = _PER_LINE) -> list[str]:
    """Return the lines of the definition of an array; `kind` is the type of its elements with its qualifiers.

    C99 has no empty arrays: one without numbers has a 0.
    """
    texts = [str(number) for number in numbers] or ["0"]
    lines = [f"    {', '.join(texts[at : at + per_line])}," for at in range(0, len(texts), per_line)]
    return [f"{kind} {name}[] = {{", *lines, "};"]


def header(mark: str, comment: str, lines: Sequence[str]) -> str:
    """Return the text of a header whose include guard is `mark`."""
    parts = [f"/* {comment} {WRITTEN} */", f"#ifndef {mark}", f"#define {mark}", "", *lines, "", "#endif", ""]
    return "\n".join(parts)


def defined(values: dict[str, tuple[object, str]]) -> list[str]:
    """Return a line for each macro: its value, and what it means."""
    return [f"#define {name} {value} /* {meaning} */" for name, (value, meaning) in values.items()]


def real(value: Any) -> str:
    """Return a number as a constant of type float, exactly."""
    return _with_point(f"{np.float32(value):.9g}") + "f"


def double(value: Any) -> str:
    """Return a number as a constant of type double, exactly."""
    return _with_point(f"{float(value):.17g}")


def braced(texts: Iterable[str], *, per_line: int = _PER_LINE) -> str:
    """Return an initialiser of an array as the value of a macro."""
    each = list(texts)
    lines = [", ".join(each[at : at + per_line]) for at in range(0, len(each), per_line)]
    return "{" + ", \\\n    ".join(lines) + "}"


def _with_point(text: str) -> str:
    return text if "." in text or "e" in text else f"{text}.0"
