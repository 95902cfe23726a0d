"""One bus of adaptive nodes, compiled: nodes that decide every millisecond, arbitration, frames bit for bit.

As in `evaluation.schemes.event_kernel`, the bus is inside: a node makes the payload anew each millisecond until its
frame wins the bus.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.adaptive import LEVELS, PAUSE_MS, Companding, SendingRule, decode_cob_id, payload_bytes
from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID, NmtState
from dbc.contract import frame_flags, sum_frame
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import FD, FD_LENGTHS
from dbc.frame_bits import wire_bits
from dbc.stuff_bits import count_fd
from evaluation.schemes.event_kernel import DATA, address, bits_of
from evaluation.schemes.wire import TICK_NS
from nodes.adaptive.sending import NOT_DUE, Groups, decide, identifier_of, make_payload, note_sent
from skin.compiled import njit
from skin.layout import Bus
from skin.sync_counter import SYNC_OVERFLOW
from skin.walsh import GROUPS

#: Milliseconds between two SYNCs.
SYNC_MS: Final = 100
#: Columns of `Record.log`: node (-1: SYNC), group (-1: heartbeat), asked, begun and ended (ns, with intermission), the
#: sample's tick, reason.
NODE, GROUP, ASKED, BEGUN, ENDED, SAMPLED, REASON = range(7)
_NOBODY: Final = 1 << 30
#: Places of length and flags in a row of `Record.rows`.
_LENGTH, _FLAGS = 4, 5


class Line(NamedTuple):
    """How long frames take on a bus.

    Attributes
    ----------
    bit_ns, data_bit_ns : float
        A bit of the nominal and of the data phase.
    flags : int
        Of frames of sums.
    fixed_bits : array of int64, shape (2, 2)
        Bits of a coarse and of a fine CAN FD frame without stuff bits: nominal, data.
    dlc : array of int64, shape (2,)
        Of these frames.
    """

    bit_ns: float
    data_bit_ns: float
    flags: int
    fixed_bits: npt.NDArray[np.int64]
    dlc: npt.NDArray[np.int64]


def line_of(bus: Bus) -> Line:
    """Return how long frames take on a bus."""
    both = np.concatenate([sum_frame(bus, is_fine=is_fine) for is_fine in (False, True)])
    bits = np.stack(wire_bits(both, "none"), axis=1).astype(np.int64)
    dlc = np.searchsorted(FD_LENGTHS, both["length"]).astype(np.int64)
    return Line(1e9 / bus.bitrate, 1e9 / (bus.data_bitrate or bus.bitrate), frame_flags(bus), bits, dlc)


class Record(NamedTuple):
    """What was sent, to be written.

    Attributes
    ----------
    rows : array of uint8, shape (capacity, 72)
        FRAME records from `can_id` on.
    log : array of int64, shape (capacity, 7)
    """

    rows: npt.NDArray[np.uint8]
    log: npt.NDArray[np.int64]


@njit(cache=True, nogil=True)
def run_bus(  # noqa: PLR0917  compiled functions take no keywords
    sums_n: Any,
    variance_n2: Any,
    noise_n2: Any,
    rule: SendingRule,
    law: Companding,
    groups: Groups,
    beat_ns: Any,
    line: Line,
    record: Record,
) -> int:
    """Run one bus and return how many frames were sent.

    Parameters
    ----------
    sums_n, variance_n2 : arrays of float32, shape (ticks, nodes, BLOCK_SUMS)
        What the nodes make of their samples, each millisecond.
    noise_n2 : array of float64, shape (ticks, nodes)
        See `nodes.adaptive.sending.noise_threshold_n2`.
    groups : Groups
        Changed to what is left at the end.
    beat_ns : array of int64, shape (nodes,)
        When each node's next heartbeat is due; changed.
    record : Record
        Written.
    """
    ticks, nodes = sums_n.shape[0], sums_n.shape[1]
    now, tick, sent, syncs = 0, 0, 0, 0
    while now < ticks * TICK_NS:
        while tick < ticks and tick * TICK_NS <= now:
            for node in range(nodes):
                decide(node, tick, sums_n[tick, node], variance_n2[tick, node], noise_n2[tick, node], rule, law, groups)
            tick += 1
        row, log = record.rows[sent], record.log[sent]
        row[:] = 0
        log[SAMPLED], log[REASON] = tick - 1, -1
        if now >= syncs * SYNC_MS * TICK_NS:
            log[NODE], log[GROUP], log[ASKED] = -1, -1, syncs * SYNC_MS * TICK_NS
            row[DATA] = syncs % SYNC_OVERFLOW + 1
            address(row, SYNC_COB_ID, 1)
            syncs += 1
        else:
            is_paused = now < ((syncs - 1) * SYNC_MS + PAUSE_MS) * TICK_NS
            node, group = _winner(groups, beat_ns, now, is_paused)
            if node < 0:
                now = _next(now, tick, syncs, beat_ns, is_paused)
                continue
            log[NODE], log[GROUP] = node, group
            if group < 0:
                log[ASKED] = beat_ns[node]
                beat_ns[node] += HEARTBEAT_MS * TICK_NS
                row[DATA] = NmtState.OPERATIONAL
                address(row, HEARTBEAT_BASE + node + 1, 1)
            else:
                log[REASON] = groups.reason[node, group]
                since = _oldest(node, group, groups)
                log[ASKED] = (since if since >= 0 else tick - 1) * TICK_NS
                identifier, payload = identifier_of(node, group, groups), row[DATA:]
                length = make_payload(node, group, sums_n[tick - 1, node], law, groups, payload)
                kind, of_frame, _ = decode_cob_id(identifier, groups.is_fd[node])
                note_sent(node, of_frame, tick - 1, kind >= LEVELS, rule, law, groups, payload)
                address(row, identifier, length)
                row[_FLAGS] = line.flags
        log[BEGUN] = now
        now += _took_ns(row, line)
        log[ENDED] = now
        sent += 1
    return sent


@njit(cache=True, nogil=True)
def _oldest(node: int, group: int, groups: Groups) -> int:
    """Return since when there is the oldest news that a group's frame tells, -1 for none."""
    since = groups.since[node, group]
    if groups.is_fd[node]:
        for each in range(GROUPS):
            other = groups.since[node, each]
            if other >= 0 and (since < 0 or other < since):
                since = other
    return int(since)


@njit(cache=True, nogil=True)
def _took_ns(row: Any, line: Line) -> int:
    """Return the time of a frame on the bus, with exact stuff bits and intermission."""
    if row[_FLAGS] & FD == 0:
        return round(bits_of(row) * line.bit_ns)
    kind = int(row[_LENGTH] == payload_bytes(True, True))
    nominal, data = count_fd(row, line.dlc[kind], row[_LENGTH])
    nominal, data = nominal + line.fixed_bits[kind, 0], data + line.fixed_bits[kind, 1]
    took_ns: float = nominal * line.bit_ns + data * line.data_bit_ns
    return round(took_ns)


@njit(cache=True, nogil=True)
def _winner(groups: Groups, beat_ns: Any, now: int, is_paused: bool) -> tuple[int, int]:
    """Return node and group of the frame with the lowest identifier; group -1 for a heartbeat, node -1 for nobody."""
    least, node, group = _NOBODY, -1, -1
    if not is_paused:
        for each in range(groups.level.shape[0]):
            for other in range(GROUPS):
                if groups.level[each, other] != NOT_DUE:
                    identifier = identifier_of(each, other, groups)
                    if identifier < least:
                        least, node, group = identifier, each, other
    if node < 0:
        for each in range(beat_ns.size):
            if beat_ns[each] <= now:
                return each, -1
    return node, group


@njit(cache=True, nogil=True)
def _next(now: int, tick: int, syncs: int, beat_ns: Any, is_paused: bool) -> int:
    """Return when something may be sent next."""
    then = min(tick * TICK_NS, syncs * SYNC_MS * TICK_NS, beat_ns.min())
    if is_paused:
        then = min(then, ((syncs - 1) * SYNC_MS + PAUSE_MS) * TICK_NS)
    return int(max(then, now + 1))
