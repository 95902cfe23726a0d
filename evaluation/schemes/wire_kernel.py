"""Arbitration of one bus, compiled."""

import heapq
from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def arbitrate(asked_ns: Any, identifier: Any, took_ns: Any) -> Any:
    """Return when the bus is free behind each frame.

    Whenever the bus is free, the frame with the lowest identifier that waits is sent; of equal ones the older.

    Parameters
    ----------
    asked_ns : array of int64, shape (k,)
        Ascending.
    identifier, took_ns : arrays of int64, shape (k,)
    """
    free_ns = np.zeros(asked_ns.size, np.int64)
    waiting = [(np.int64(0), 0)]
    waiting.pop()
    now, come, done = np.int64(0), 0, 0
    while done < asked_ns.size:
        while come < asked_ns.size and (asked_ns[come] <= now or not waiting):
            now = max(now, asked_ns[come])
            heapq.heappush(waiting, (identifier[come], come))
            come += 1
        frame = heapq.heappop(waiting)[1]
        now += took_ns[frame]
        free_ns[frame] = now
        done += 1
    return free_ns
