"""Send-on-delta on one bus, compiled: nodes that compare, arbitrate and fill their frames, bit for bit."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from bandwidth.kernels import count_classic

#: Events a frame of 8 bytes holds: 5 bits of place in the node and 11 of value each.
EVENTS: Final = 4
#: Taxels of one node, as many as the place can tell.
TAXELS: Final = 32
VALUE_BITS: Final = 11
#: Bits of a classic frame that are never stuffed or are there without any data, intermission included.
EMPTY_BITS: Final = 47
TICK_NS: Final = 1_000_000
#: Columns of `log`: node, asked, begun and ended (all ns, the end with intermission), events; a heartbeat has none.
NODE, ASKED, BEGUN, ENDED, COUNT = range(5)
#: Columns of `state`: value last sent, tick since when it is to be sent again (-1: it is not), tick of the last sending.
SENT, SINCE, LAST = range(3)
_NEVER: Final = -(1 << 30)
_CAN_ID, _LENGTH, _DATA = 0, 4, 8
_HEARTBEAT_BASE: Final = 0x700
_OPERATIONAL: Final = 5


def new_state(nodes: int) -> npt.NDArray[np.int64]:
    """Return the state of nodes whose taxels were all sent as 0 long ago."""
    state = np.zeros((3, nodes, TAXELS), np.int64)
    state[SINCE], state[LAST] = -1, _NEVER
    return state


@njit(cache=True, nogil=True)
def send_on_delta(counts: Any, wish: Any, beats: Any, bit_ns: int, state: Any, rows: Any, log: Any, since: Any) -> int:
    """Run one bus and return how many frames were sent.

    Whenever the bus is free, every node that has something to say takes part with its one identifier; the winner sends
    its most changed taxels with the values they have at that moment, which no real controller could better.

    Parameters
    ----------
    counts : array of int16, shape (ticks, nodes, TAXELS)
        What every taxel reads, each millisecond.
    wish : tuple of int
        Threshold in counts, and the least ticks between two sendings of one taxel.
    beats : array of int64, shape (nodes,)
        When each node sends its first heartbeat, ns; one a second follows.
    bit_ns : int
    state : array of int64, shape (3, nodes, TAXELS)
        From `new_state`; written: what is left at the end.
    rows : array of uint8, shape (capacity, 72)
        Written: the frames sent, FRAME records from `can_id` on.
    log : array of int64, shape (capacity, 5)
        Written.
    since : array of int64, shape (capacity, EVENTS)
        Written: the tick at which each event's change first reached the threshold.
    """
    ticks, nodes, _ = counts.shape
    pending, asked, due = np.zeros(nodes, np.int64), np.zeros(nodes, np.int64), beats.copy()
    now, tick, sent = 0, 0, 0
    while sent < rows.shape[0]:
        while tick < ticks and tick * TICK_NS <= now:
            _compare(counts[tick], tick, wish, state, pending, asked)
            tick += 1
        if now >= ticks * TICK_NS:
            break
        node, is_beat = _winner(pending, due, now)
        if node < 0:
            now = min(due.min(), tick * TICK_NS)
            continue
        row = rows[sent]
        log[sent, NODE], log[sent, BEGUN] = node, now
        if is_beat:
            log[sent, ASKED], log[sent, COUNT] = due[node], 0
            due[node] += 1000 * TICK_NS
            _address(row, _HEARTBEAT_BASE + node + 1, 1)
            row[_DATA] = _OPERATIONAL
        else:
            log[sent, ASKED] = asked[node]
            log[sent, COUNT] = _fill(counts[tick - 1, node], tick - 1, wish, state[:, node], row, since[sent])
            pending[node] -= log[sent, COUNT]
            _address(row, 0x180 + node + 1, 2 * log[sent, COUNT])
        now += (EMPTY_BITS + 8 * int(row[_LENGTH]) + count_classic(row)) * bit_ns
        log[sent, ENDED] = now
        if not is_beat:
            asked[node] = now
        sent += 1
    return sent


@njit(cache=True, nogil=True)
def _compare(now: Any, tick: int, wish: Any, state: Any, pending: Any, asked: Any) -> None:
    """Look at every taxel: since when has it changed, and how many of each node are to be sent."""
    for node in range(now.shape[0]):
        before = pending[node]
        pending[node] = 0
        for taxel in range(TAXELS):
            if abs(now[node, taxel] - state[SENT, node, taxel]) < wish[0]:
                state[SINCE, node, taxel] = -1
                continue
            if state[SINCE, node, taxel] < 0:
                state[SINCE, node, taxel] = tick
            pending[node] += tick - state[LAST, node, taxel] >= wish[1]
        if before == 0:
            asked[node] = tick * TICK_NS


@njit(cache=True, nogil=True)
def _winner(pending: Any, due: Any, now: int) -> tuple[int, bool]:
    """Return the node whose frame has the lowest identifier, and whether that is a heartbeat; -1 for nobody."""
    for node in range(pending.size):
        if pending[node]:
            return node, False
    for node in range(pending.size):
        if due[node] <= now:
            return node, True
    return -1, False


@njit(cache=True, nogil=True)
def _fill(now: Any, tick: int, wish: Any, state: Any, row: Any, since: Any) -> int:
    """Write the most changed taxels of a node into its frame, and note them as sent; return how many."""
    events = 0
    while events < EVENTS:
        best, most = -1, wish[0] - 1
        for taxel in range(TAXELS):
            change = abs(now[taxel] - state[SENT, taxel])
            if change > most and state[SINCE, taxel] >= 0 and tick - state[LAST, taxel] >= wish[1]:
                best, most = taxel, change
        if best < 0:
            break
        value = int(now[best])
        row[_DATA + 2 * events] = value & 0xFF
        row[_DATA + 2 * events + 1] = (best << VALUE_BITS - 8) | (value >> 8)
        since[events] = state[SINCE, best]
        state[SENT, best], state[SINCE, best], state[LAST, best] = value, -1, tick
        events += 1
    return events


@njit(cache=True, nogil=True)
def _address(row: Any, can_id: int, length: int) -> None:
    """Write identifier and length of a frame."""
    row[_CAN_ID], row[_CAN_ID + 1], row[_LENGTH] = can_id & 0xFF, can_id >> 8, length
