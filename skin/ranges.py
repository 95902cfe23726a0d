"""Lists of texts, and ranges of numbers: as text, and checked."""

import math
import re
from collections.abc import Iterable
from itertools import groupby

from canskin.errors import InputError


def listed(texts: Iterable[str]) -> list[str]:
    """Return the texts of a list option, which the user may separate by spaces or commas.

    Examples
    --------
    >>> listed(["p0:3,p0:5", "patch2@3,4:step:0.001,whole:step:0.001"])
    ['p0:3', 'p0:5', 'patch2@3,4:step:0.001', 'whole:step:0.001']
    """
    return [each.strip() for text in texts for each in re.findall(r"(?:@\d+,|[^,])+", text) or [text]]


def ranges_text(numbers: Iterable[int]) -> str:
    """Return numbers in ascending order, such as ``1-3, 7``."""
    ordered = sorted(set(numbers))
    runs = [[number for _, number in run] for _, run in groupby(enumerate(ordered), key=lambda pair: pair[1] - pair[0])]
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def require_above_zero(name: str, value: float, most: float = math.inf) -> None:
    """Check a number above 0, up to `most`."""
    if not (math.isfinite(value) and 0 < value <= most):
        expected = "a number above 0" if most == math.inf else f"a number above 0, up to {most:g}"
        raise InputError(f"{name} needs {expected}: got {value}")


def require_number(name: str, value: float, most: float = math.inf) -> None:
    """Check a number from 0 to `most`."""
    if not (math.isfinite(value) and 0 <= value <= most):
        expected = "a number of 0 or more" if most == math.inf else f"a number from 0 to {most:g}"
        raise InputError(f"{name} needs {expected}: got {value}")
