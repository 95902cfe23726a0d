"""Send-on-delta on one bus, compiled: nodes that compare, arbitrate and fill their frames, bit for bit.

The bus is inside, because a node chooses what its frame carries when the frame wins arbitration: no frame is known
beforehand, as `bus.core` and `evaluation.schemes.wire` need it. The tests hold the frames against `bus.core`.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.canopen import HEARTBEAT_BASE, TPDO_BASES, NmtState
from dbc.dictionary import HEARTBEAT_MS
from dbc.stuff_bits import count_classic
from evaluation.schemes.wire import TICK_NS
from skin.compiled import njit

#: Events a frame of 8 bytes holds: 5 bits of place in the node and 11 of value each.
EVENTS: Final = 4
#: Taxels of one node, as many as the place can tell.
TAXELS: Final = 32
VALUE_BITS: Final = 11
#: Bits of a classic frame that are there without any data, unstuffed, intermission included.
EMPTY_BITS: Final = 47
#: Columns of `Record.log`: node, asked, begun and ended (ns, with intermission), events; a heartbeat has none.
NODE, ASKED, BEGUN, ENDED, COUNT = range(5)
#: Rows of `Nodes.taxels`: value last sent, tick since when it waits to be sent (-1: it does not), tick of last sending.
SENT, SINCE, LAST = range(3)
_NEVER: Final = -(1 << 30)
#: Places of identifier, length and data in a row of `Record.rows`.
_CAN_ID, _LENGTH, DATA = 0, 4, 8
_TPDO_BASE: Final = TPDO_BASES[0]

Integers = npt.NDArray[np.int64]


class Rule(NamedTuple):
    """When a taxel is sent, and how long a bit is.

    Attributes
    ----------
    threshold : int
        Counts by which it has changed since it was sent.
    dead_ticks : int
        Least ticks between two sendings.
    bit_ns : int
    """

    threshold: int
    dead_ticks: int
    bit_ns: int


class Nodes(NamedTuple):
    """What the nodes of a bus know.

    Attributes
    ----------
    taxels : array of int64, shape (3, nodes, TAXELS)
    pending, asked_ns, beat_ns : arrays of int64, shape (nodes,)
        Taxels to be sent, since when its frame takes part, and when the next heartbeat is due.
    """

    taxels: Integers
    pending: Integers
    asked_ns: Integers
    beat_ns: Integers


class Record(NamedTuple):
    """What was sent, to be written.

    Attributes
    ----------
    rows : array of uint8, shape (capacity, 72)
        FRAME records from `can_id` on.
    log : array of int64, shape (capacity, 5)
    since : array of int64, shape (capacity, EVENTS)
        The tick at which each event's change first reached the threshold.
    """

    rows: npt.NDArray[np.uint8]
    log: Integers
    since: Integers


def new_nodes(beat_ns: Integers) -> Nodes:
    """Return nodes whose taxels were all sent as 0 long ago; `beat_ns` of shape (nodes,)."""
    nodes = len(beat_ns)
    taxels = np.zeros((3, nodes, TAXELS), np.int64)
    taxels[SINCE], taxels[LAST] = -1, _NEVER
    return Nodes(taxels, np.zeros(nodes, np.int64), np.zeros(nodes, np.int64), beat_ns.copy())


@njit(cache=True, nogil=True)
def send_on_delta(counts: Any, rule: Rule, nodes: Nodes, record: Record) -> int:
    """Run one bus and return how many frames were sent.

    Whenever the bus is free, every node that has something to say takes part with its one identifier; the winner sends
    its most changed taxels with the values they have at that moment, which no real controller could better.

    Parameters
    ----------
    counts : array of int16, shape (ticks, nodes, TAXELS)
        What every taxel reads, each millisecond.
    rule : Rule
    nodes : Nodes
        Changed to what is left at the end.
    record : Record
        Written.
    """
    ticks = counts.shape[0]
    now, tick, sent = 0, 0, 0
    while now < ticks * TICK_NS:
        while tick < ticks and tick * TICK_NS <= now:
            _compare(counts[tick], tick, rule, nodes)
            tick += 1
        node, is_beat = _winner(nodes, now)
        if node < 0:
            now = min(nodes.beat_ns.min(), tick * TICK_NS)
            continue
        row, log = record.rows[sent], record.log[sent]
        log[NODE], log[BEGUN] = node, now
        if is_beat:
            log[ASKED], log[COUNT] = nodes.beat_ns[node], 0
            nodes.beat_ns[node] += HEARTBEAT_MS * TICK_NS
            row[DATA] = NmtState.OPERATIONAL
            address(row, HEARTBEAT_BASE + node + 1, 1)
        else:
            log[ASKED] = nodes.asked_ns[node]
            log[COUNT] = _fill(counts[tick - 1, node], tick - 1, rule, nodes.taxels[:, node], (row, record.since[sent]))
            nodes.pending[node] -= log[COUNT]
            address(row, _TPDO_BASE + node + 1, 2 * log[COUNT])
        now += bits_of(row) * rule.bit_ns
        log[ENDED] = now
        if not is_beat:
            nodes.asked_ns[node] = now
        sent += 1
    return sent


@njit(cache=True, nogil=True)
def _compare(now: Any, tick: int, rule: Rule, nodes: Nodes) -> None:
    """Look at every taxel: since when has it changed, and how many of each node are to be sent."""
    for node in range(now.shape[0]):
        before = nodes.pending[node]
        nodes.pending[node] = 0
        for taxel in range(TAXELS):
            if abs(now[node, taxel] - nodes.taxels[SENT, node, taxel]) < rule.threshold:
                nodes.taxels[SINCE, node, taxel] = -1
                continue
            if nodes.taxels[SINCE, node, taxel] < 0:
                nodes.taxels[SINCE, node, taxel] = tick
            nodes.pending[node] += tick - nodes.taxels[LAST, node, taxel] >= rule.dead_ticks
        if before == 0:
            nodes.asked_ns[node] = tick * TICK_NS


@njit(cache=True, nogil=True)
def _winner(nodes: Nodes, now: int) -> tuple[int, bool]:
    """Return the node whose frame has the lowest identifier, and whether that is a heartbeat; -1 for nobody."""
    for node in range(nodes.pending.size):
        if nodes.pending[node]:
            return node, False
    for node in range(nodes.pending.size):
        if nodes.beat_ns[node] <= now:
            return node, True
    return -1, False


@njit(cache=True, nogil=True)
def _fill(now: Any, tick: int, rule: Rule, taxels: Any, frame: Any) -> int:
    """Write the most changed taxels of a node into its frame, and note them as sent; return how many."""
    row, since = frame
    events = 0
    while events < EVENTS:
        best, most = -1, rule.threshold - 1
        for taxel in range(TAXELS):
            change = abs(now[taxel] - taxels[SENT, taxel])
            if change > most and taxels[SINCE, taxel] >= 0 and tick - taxels[LAST, taxel] >= rule.dead_ticks:
                best, most = taxel, change
        if best < 0:
            break
        value = int(now[best])
        row[DATA + 2 * events] = value & 0xFF
        row[DATA + 2 * events + 1] = (best << VALUE_BITS - 8) | (value >> 8)
        since[events] = taxels[SINCE, best]
        taxels[SENT, best], taxels[SINCE, best], taxels[LAST, best] = value, -1, tick
        events += 1
    return events


@njit(cache=True, nogil=True)
def bits_of(row: Any) -> int:
    """Return the bits of a frame on the wire, stuff bits and intermission included."""
    return int(EMPTY_BITS + 8 * int(row[_LENGTH]) + count_classic(row))


@njit(cache=True, nogil=True)
def address(row: Any, can_id: int, length: int) -> None:
    """Write identifier and length of a frame."""
    row[_CAN_ID], row[_CAN_ID + 1], row[_LENGTH] = can_id & 0xFF, can_id >> 8, length
