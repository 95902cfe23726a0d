"""How two documents differ, in words: layouts, what models and data sets tell of their skin."""

from collections.abc import Iterator
from typing import Any, Final

#: Most differences that a message names, and most characters of a value.
_NAMED: Final = 4
_CHARACTERS: Final = 40


def difference(here: Any, there: Any, path: str = "$", says: str = "there") -> str:
    """Return the path of each value that differs in two documents, with both values; empty if none does.

    Parameters
    ----------
    here, there : dict
        Decoded TOML or JSON.
    path : str
        Of the document `here`.
    says : str
        Words before a value of `there`.
    """
    named = list(_named(here, there, path, says))
    more = f"; and {len(named) - _NAMED} more" * (len(named) > _NAMED)
    return "; ".join(named[:_NAMED]) + more


def _named(here: Any, there: Any, path: str, says: str) -> Iterator[str]:
    if isinstance(here, dict) and isinstance(there, dict):
        for key in {**here, **there}:
            yield from _named(here.get(key), there.get(key), f"{path}.{key}", says)
    elif isinstance(here, list) and isinstance(there, list) and len(here) == len(there) and path == "$.bus":
        for place, pair in enumerate(zip(here, there, strict=True)):
            yield from _named(*pair, f"{path}[{place}]", says)
    elif here != there:
        yield f"`{path}` is {_short(here)}, {says} {_short(there)}"


def _short(value: Any) -> str:
    text = "not given" if value is None else repr(value)
    return text if len(text) <= _CHARACTERS else f"{text[:_CHARACTERS]}..."
