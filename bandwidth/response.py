"""Worst-case response times of the messages of one bus.

R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien: Controller Area Network (CAN) schedulability analysis: refuted,
revisited and revised. Real-Time Systems 35 (2007). Unlike the analysis of 1994 it looks at every instance of a
message in its busy period. CAN FD changes the lengths of frames alone.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.response_kernel import UNBOUNDED, all_responses
from skin.errors import InputError

__all__ = ["ERROR_BITS", "UNBOUNDED", "blocking_ns", "response_times_ns"]

#: Longest error frame and the intermission behind it (Davis et al., section 3.5).
ERROR_BITS: Final = 31

Nanoseconds = npt.NDArray[np.int64]


def blocking_ns(time_ns: npt.NDArray[np.integer]) -> Nanoseconds:
    """Return the longest frame of lower priority than each; frames by falling priority, shape (n,)."""
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
        Longest frame time with intermission, least time between two messages, and how long after its event a message
        may be queued; by falling priority.
    bit_ns : int
        One bit at the nominal rate: a message queued within it after the start of a frame has not missed it.
    blocked_ns : array of int, shape (n,), optional
        Longest frame that may have begun just before; default those of lower priority (`blocking_ns`).
    error_interval_ns : int
        Least time between two errors, each of which costs an error frame and the longest frame up to that priority
        again; 0 for a bus without errors.

    Returns
    -------
    array of int64, shape (n,)
        `UNBOUNDED` where messages up to that priority ask for all the bus has.

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
