"""Lists of names on the command line."""

from collections.abc import Iterable


def split_names(given: Iterable[str]) -> tuple[str, ...]:
    """Return the names of a list option, without repetition; the user may separate them by spaces or commas.

    Examples
    --------
    >>> split_names(["golf-ball,ring", "cup", "ring"])
    ('golf-ball', 'ring', 'cup')
    """
    return tuple(dict.fromkeys(name.strip() for each in given for name in each.split(",") if name.strip()))
