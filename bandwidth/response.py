"""Worst-case response times of the messages of one bus.

R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien: Controller Area Network (CAN) schedulability analysis: refuted,
revisited and revised. Real-Time Systems 35 (2007). Unlike the analysis of 1994, this analysis examines every instance
of a message in its busy period. CAN FD changes only the lengths of frames.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.response_kernel import UNBOUNDED, all_responses
from canskin.errors import InputError

__all__ = ["ERROR_BITS", "UNBOUNDED", "blocking_ns", "response_times_ns"]

#: Longest error frame, with intermission (Davis et al., section 3.5).
ERROR_BITS: Final = 31

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
    """Bound the time from the event that queues a message to the end of its frame.

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

    Raises
    ------
    InputError
        If a time is out of range.
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
