"""The urgency of news, from additions, multiplications and divisions alone: alike on every machine."""

import math

from dbc.adaptive import LEVELS, SendingRule
from dbc.adaptive_filter import LEAST_PART, LOG2_SERIES
from skin.compiled import njit


@njit(cache=True, nogil=True)
def log2_of(value: float) -> float:
    """Return the binary logarithm of a number above 0, to 1e-15.

    A library's `log2` may round differently on another machine.
    """
    part, exponent = math.frexp(value)
    if part < LEAST_PART:
        part, exponent = part + part, exponent - 1
    ratio = (part - 1.0) / (part + 1.0)
    square = ratio * ratio
    total = LOG2_SERIES[-1]
    for place in range(len(LOG2_SERIES) - 2, -1, -1):
        total = LOG2_SERIES[place] + square * total
    return exponent + ratio * total


@njit(cache=True, nogil=True)
def urgency(ratio: float, waited: int, rule: SendingRule) -> int:
    """Return the level of news that exceeds its threshold by `ratio` and has waited for `waited` samples.

    The highest level is for what waited, so that no motion of others holds it back for ever.
    """
    if waited >= rule.patience:
        return LEVELS - 1
    # Compared before it is made whole: with a tiny number of the rule it is too large for an integer.
    return int(min(float(LEVELS - 2), (log2_of(ratio) + waited / rule.doubling) / rule.level_ratio))
