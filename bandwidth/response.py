"""Worst-case response times of the messages of one bus.

R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien: Controller Area Network (CAN) schedulability analysis: refuted,
revisited and revised. Real-Time Systems 35 (2007). Unlike the analysis of 1994, this analysis examines every instance
of a message in its busy period. CAN FD changes only the lengths of frames.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import int64, void

from canskin.errors import InputError
from shell.compiled import njit

#: Longest error frame, with intermission (Davis et al., section 3.5).
ERROR_BITS: Final = 31
#: Columns of the table of messages, nanoseconds; one row per message, by falling priority.
_ROWS: Final = int64[:, ::1]
TIME, PERIOD, JITTER, BLOCKING = range(4)
#: Bus: bit time, error frame, shortest time between two errors or 0; nanoseconds.
_WIRE: Final = int64[::1]
BIT, ERROR_FRAME, ERROR_INTERVAL = range(3)
#: Value of a response time without a bound.
UNBOUNDED: Final = 2**63 - 1

Nanoseconds = npt.NDArray[np.int64]


def blocking_ns(time_ns: npt.NDArray[np.integer]) -> Nanoseconds:
    """Return, for each frame, the longest frame of lower priority; frames by falling priority, shape (n,)."""
    behind = np.append(time_ns, 0).astype(np.int64)
    longest: Nanoseconds = np.maximum.accumulate(behind[::-1])[::-1][1:]
    return np.ascontiguousarray(longest)


def response_times_ns(
    time_ns: npt.NDArray[np.integer],
    period_ns: npt.NDArray[np.integer],
    jitter_ns: npt.NDArray[np.integer],
    *,
    bit_ns: int = 1000,
    blocked_ns: npt.NDArray[np.integer] | None = None,
    error_interval_ns: int = 0,
) -> Nanoseconds:
    """Bound the time from the event that queues a message to the end of its frame; InputError refuses wrong times.

    Parameters
    ----------
    time_ns, period_ns, jitter_ns : array of int, shape (n,)
        Longest frame time with intermission, shortest time between two messages, and longest time from the event to the
        queue; by falling priority.
    bit_ns : int
        One bit at the nominal rate: a message queued within one bit after a start of frame takes part in arbitration.
    blocked_ns : array of int, shape (n,), optional
        Longest frame that may have begun just before; default: frames of lower priority (`blocking_ns`).
    error_interval_ns : int
        Shortest time between two errors; 0 for a bus without errors. Each error costs an error frame and the longest
        frame of the same or a higher priority.

    Returns
    -------
    array of int64, shape (n,)
        `UNBOUNDED` if the messages of the same and higher priorities fill the bus.
    """
    columns = [np.asarray(each, np.int64) for each in (time_ns, period_ns, jitter_ns)]
    time, period, jitter = columns
    if any(each.shape != time.shape or each.ndim != 1 for each in columns):
        raise InputError("expected one time, period and jitter per message")
    if (time <= 0).any() or (period <= 0).any() or (jitter < 0).any() or bit_ns <= 0 or error_interval_ns < 0:
        raise InputError(
            "expected times, periods and the bit time above 0, jitters and the error interval of 0 or more"
        )
    blocked = blocking_ns(time) if blocked_ns is None else np.asarray(blocked_ns, np.int64)
    found = np.empty_like(time)
    wire = np.array([bit_ns, ERROR_BITS * bit_ns, error_interval_ns], np.int64)
    all_responses(np.stack([time, period, jitter, blocked], axis=1), wire, found)
    return found


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
