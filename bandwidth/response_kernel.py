"""Fixed points of the response-time analysis, compiled."""

from typing import Any, Final

from numba import int64, void

from skin.compiled import njit

#: Columns of the table of messages, nanoseconds; one row per message, by falling priority.
_ROWS: Final = int64[:, ::1]
TIME, PERIOD, JITTER, BLOCKING = range(4)
#: Bus: bit time, error frame, shortest time between two errors or 0; nanoseconds.
_WIRE: Final = int64[::1]
BIT, ERROR_FRAME, ERROR_INTERVAL = range(3)
#: Value of a response time without a bound.
UNBOUNDED: Final = 2**63 - 1


@njit(int64(int64, int64, int64), cache=True, nogil=True)
def arrivals(length: int, jitter: int, period: int) -> int:
    """Return the largest number of messages queued in a half-open interval of `length`."""
    return (length + jitter + period - 1) // period


@njit(int64(_ROWS, int64, int64), cache=True, nogil=True)
def demand(rows: Any, count: int, length: int) -> int:
    """Return the largest bus time of the first `count` messages in an interval of `length`."""
    total = 0
    for each in range(count):
        total += arrivals(length, rows[each, JITTER], rows[each, PERIOD]) * rows[each, TIME]
    return total


@njit(int64(_ROWS, int64, _WIRE), cache=True, nogil=True)
def error_time(rows: Any, message: int, wire: Any) -> int:
    """Return the cost of one error for a message: an error frame, and the longest frame of its priority or higher."""
    longest = 0
    for each in range(message + 1):
        longest = max(longest, int(rows[each, TIME]))
    return int(wire[ERROR_FRAME]) + longest


@njit(int64(_ROWS, int64, _WIRE), cache=True, nogil=True)
def response(rows: Any, message: int, wire: Any) -> int:
    """Return the worst-case response time of one message."""
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
        wait += own  # the next instance waits at least for this instance
    return worst


@njit(void(_ROWS, _WIRE, int64[::1]), cache=True, nogil=True)
def all_responses(rows: Any, wire: Any, found: Any) -> None:
    """Write the worst-case response time of every message to `found`."""
    for message in range(rows.shape[0]):
        found[message] = response(rows, message, wire)
