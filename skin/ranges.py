"""Ascending numbers as text."""

from collections.abc import Iterable
from itertools import groupby


def ranges_text(numbers: Iterable[int]) -> str:
    """Return numbers in ascending order, such as ``1-3, 7``."""
    ordered = sorted(set(numbers))
    runs = [[number for _, number in run] for _, run in groupby(enumerate(ordered), key=lambda pair: pair[1] - pair[0])]
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
