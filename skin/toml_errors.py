"""Error messages about a TOML file for its author.

msgspec tells what a type expected. The author also needs the value that came, and the possible keys and values.
"""

import difflib
import re
from types import NoneType
from typing import Any, Final, get_args, get_origin, get_type_hints

import msgspec

_KINDS: Final = {
    "int": "a whole number",
    "float": "a number",
    "str": "text in quotes",
    "bool": "true or false",
    "array": "a list, of tables or values",
    "object": "a table",
}
#: Keys of before, and what became of them.
_GONE: Final = {
    "identity": "went, because every frame now names its cycle: leave it out; logs and recordings of before cannot be"
    " used any more",
    "recognition": 'went with the boards of two states: leave it out; boards rest with sending = "steps"',
}
#: Letters that a misspelt key shares with the key that was meant; "recognition" and "region" share 0.71.
_NEAR_RATIO: Final = 0.75
_BOUNDS: Final = {">=": "or more", "<=": "or less", ">": "or more, exclusive", "<": "or less, exclusive"}


def in_words(problem: str, document: Any, root: type[msgspec.Struct]) -> str:
    """Return msgspec's message about `document`, converted to `root`, as text: what was expected, what came, where.

    Parameters
    ----------
    problem : str
        As ``str(error)`` of the `msgspec.ValidationError`.
    document : dict
        The decoded file.
    root : type
        The struct that the file must fit.
    """
    said, _, place = problem.partition(" - at ")
    keys = re.findall(r"\w+", place)  # $.bus[1].nodes: bus, 1, nodes
    for pattern, words in _WORDS:
        if found := re.fullmatch(pattern, said):
            text = words(found, _table(root, keys), keys, _value(document, keys))
            return f"{text} - at {place}" if place else text
    return problem


def _unknown(found: re.Match[str], table: type, _keys: list[str], _value: Any) -> str:
    if found[1] in _GONE:
        return f"the key `{found[1]}` {_GONE[found[1]]}"
    known = [field.encode_name for field in msgspec.structs.fields(table)]
    near = difflib.get_close_matches(found[1], known, 1, _NEAR_RATIO)
    expected = f"did you mean `{near[0]}`?" if near else f"expected one of {', '.join(known)}"
    return f"unknown key `{found[1]}`: {expected}"


def _missing(found: re.Match[str], _table: type, _keys: list[str], _value: Any) -> str:
    advice = ": give [[bus]], or [taxels] alone, whose buses are made" if found[1] == "bus" else ""
    return f"the key `{found[1]}` is missing{advice}"


def _choice(_found: re.Match[str], table: type, keys: list[str], value: Any) -> str:
    hints = get_args(get_type_hints(table)[keys[-1]])
    choices = [choice for hint in hints if hint is not NoneType for choice in get_args(hint) or (hint,)]
    return f"expected {' or '.join(map(str, choices))}, got {_shown(value)}"


def _kind(found: re.Match[str], _table: type, _keys: list[str], value: Any) -> str:
    return f"expected {_KINDS.get(found[1].removesuffix(' | null'), found[1])}, got {_shown(value)}"


def _bound(found: re.Match[str], _table: type, _keys: list[str], value: Any) -> str:
    return f"expected {found[2]} {_BOUNDS[found[1]]}, got {_shown(value)}"


def _name(_found: re.Match[str], _table: type, _keys: list[str], value: Any) -> str:
    return f"expected a name of a to z, 0 to 9 and _ that begins with a letter, got {_shown(value)}"


def _length(found: re.Match[str], _table: type, _keys: list[str], value: Any) -> str:
    count, of = int(found[3]), "character" if found[1] == "str" else "entry"
    return f"expected {count} {of}{'s' * (count != 1)} {_BOUNDS[found[2]]}, got {len(value)}"


_WORDS: Final = (
    (r"Object contains unknown field `(.+)`", _unknown),
    (r"Object missing required field `(.+)`", _missing),
    (r"Invalid enum value .*", _choice),
    (r"Expected `(.+)`, got `.+`", _kind),
    (r"Expected `\w+` ([<>]=?) (\S+)", _bound),
    (r"Expected `str` matching regex .*", _name),
    (r"Expected `(str|array)` of length ([<>]=?) (\d+)", _length),
)


def _table(root: type, keys: list[str]) -> type:
    """Return the struct at `keys`, or the struct that contains the last of `keys`."""
    table = root
    for key in keys:
        hint = get_type_hints(table).get(key)
        # A list of tables, or a table that may be missing.
        if get_origin(hint) in {list, tuple} or NoneType in get_args(hint):
            hint = get_args(hint)[0]
        if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
            table = hint
    return table


def _value(document: Any, keys: list[str]) -> Any:
    value = document
    for key in keys:
        value = value[int(key)] if isinstance(value, list) else value[key]
    return value


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "an array"
    text = msgspec.json.encode(value).decode() if isinstance(value, bool | str) else str(value)
    return text if len(text) <= 40 else text[:37] + "..."
