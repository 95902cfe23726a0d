"""Calls timed in turn."""

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

#: Least time of a turn, so that every call has the caches to itself, the short ones too.
TURN_S: Final = 0.02


def race(calls: Sequence[Callable[[], Any]], rounds: int) -> list[list[float]]:
    """Run all calls in turn, `rounds` times after a first turn that compiles and does not count.

    Returns
    -------
    list of lists of float
        Seconds of one call in each of its turns, averages over a turn.
    """
    times_s: list[list[float]] = [[] for _ in calls]
    for turn in range(rounds + 1):
        for call, own_s in zip(calls, times_s, strict=True):
            started_s, count, elapsed_s = time.perf_counter(), 0, 0.0
            while elapsed_s < TURN_S:
                call()
                count += 1
                elapsed_s = time.perf_counter() - started_s
            if turn:
                own_s.append(elapsed_s / count)
    return times_s
