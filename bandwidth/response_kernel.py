"""Fixed points of the response-time analysis, compiled."""

from typing import Any, Final

from numba import int64, njit, void

#: Messages by falling priority, one row each: the columns below, in nanoseconds.
_ROWS: Final = int64[:, ::1]
TIME, PERIOD, JITTER, BLOCKING = range(4)
#: Of the bus: bit time, error frame, least time between two errors or 0.
_WIRE: Final = int64[::1]
BIT, ERROR_FRAME, ERROR_INTERVAL = range(3)
#: Stands for a response without a bound.
UNBOUNDED: Final = 2**63 - 1


@njit(int64(int64, int64, int64), cache=True, nogil=True)
def arrivals(length: int, jitter: int, period: int) -> int:
    """Return how many messages can be queued in a half-open interval of `length`."""
    return (length + jitter + period - 1) // period


@njit(int64(_ROWS, int64, int64), cache=True, nogil=True)
def demand(rows: Any, count: int, length: int) -> int:
    """Return the time that the first `count` messages can ask for in an interval of `length`."""
    total = 0
    for each in range(count):
        total += arrivals(length, rows[each, JITTER], rows[each, PERIOD]) * rows[each, TIME]
    return total


@njit(int64(_ROWS, int64, _WIRE), cache=True, nogil=True)
def error_time(rows: Any, message: int, wire: Any) -> int:
    """Return what one error costs a message: an error frame and the longest frame up to its priority again."""
    longest = 0
    for each in range(message + 1):
        longest = max(longest, int(rows[each, TIME]))
    return int(wire[ERROR_FRAME]) + longest


@njit(int64(_ROWS, int64, _WIRE), cache=True, nogil=True)
def response(rows: Any, message: int, wire: Any) -> int:
    """Return the worst response of one message."""
    own, period, jitter, blocking = rows[message]
    interval, error = wire[ERROR_INTERVAL], error_time(rows, message, wire)
    utilisation = error / interval if interval else 0.0
    for each in range(message + 1):
        utilisation += rows[each, TIME] / rows[each, PERIOD]
    if utilisation >= 1.0:
        return UNBOUNDED
    busy, before = own, 0
    while busy != before:
        before = busy
        lost = arrivals(before, 0, interval) * error if interval else 0
        busy = lost + blocking + demand(rows, message + 1, before)
    worst, wait = 0, blocking
    for instance in range(arrivals(busy, jitter, period)):
        before = -1
        while wait != before:
            before = wait
            lost = arrivals(before + own, 0, interval) * error if interval else 0
            wait = lost + blocking + instance * own + demand(rows, message, before + wire[BIT])
        worst = max(worst, int(jitter + wait - instance * period + own))
        wait += own  # the next instance waits at least for this one
    return worst


@njit(void(_ROWS, _WIRE, int64[::1]), cache=True, nogil=True)
def all_responses(rows: Any, wire: Any, found: Any) -> None:
    """Write the worst response of every message into `found`."""
    for message in range(rows.shape[0]):
        found[message] = response(rows, message, wire)
