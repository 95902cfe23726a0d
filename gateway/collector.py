"""From frames to one measurement: the frames of one SYNC, each used once, none of another cycle.

A frame is used when it comes from its own bus, has the length of its PDO, and belongs to the cycle of the newest SYNC
on that bus. Every other frame is counted by kind and not used.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.messages import FrameCounts
from dbc.canopen import BASE_ID_MASK, SYNC_COB_ID
from dbc.codec import read_raw
from dbc.contract import Contract, FrameTable
from dbc.frame import (
    CAN_ID_AT,
    DATA_AT,
    ECHO,
    ERROR,
    EXTENDED,
    FD,
    FLAGS_AT,
    LENGTH_AT,
    REMOTE,
    TIME_AT,
    Frames,
    frame_bytes,
    frames,
)
from dbc.frame_fields import field
from gateway.bus_syncs import BusSyncs, begin_on_bus, new_syncs, send_sync
from gateway.open_cycles import (
    SLOTS,
    Flags,
    Integers,
    OpenCycles,
    begin_cycle,
    is_open,
    keep_frame,
    new_cycles,
    slot_of,
    spoil_bus,
)
from gateway.outstanding import EVERY, Outstanding, ask, came, doubt, new_outstanding, prove, rest
from gateway.proven_blocks import ProvenBlocks
from gateway.sync_times import NO_STAMPS, SampledTimes, SyncNotes, SyncTimes, note_answer, note_echo
from shell.compiled import borrowed, njit
from skin.sync_counter import next_counter

#: A node whose phases are swapped for this many cycles in a row is reported.
SWAPPED_CYCLES: Final = 5
#: On an unordered bus, a node that owes frames at this many SYNCs in a row is reported.
BEHIND_CYCLES: Final = 8


@dataclass(frozen=True)
class Gathered:
    """One cycle: `sums` int32 (m,), 0 where invalid; `valid` bool (blocks,); `times` of the sampling.

    A block without sums is never valid; a cycle is `complete` if all other blocks are.
    """

    sums: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    times: SampledTimes
    complete: bool


class Gathering(NamedTuple):
    """What the frames of all buses have told.

    Attributes
    ----------
    cycles, syncs, outstanding, notes
        See their classes.
    counts : array of int64, shape (6,)
        By `ACCEPTED` to `FOREIGN`, see `FrameCounts`.
    foreign_syncs : array of int64, shape (buses,)
    late_of_node, missing_of_node : arrays of int64, shape (nodes,)
    heard, strayed : arrays of bool, shape (nodes,)
        Nodes that sent a TPDO, and those that sent a PDO of the other phase in this cycle.
    swapped_cycles : array of int64, shape (nodes,)
        Cycles in a row in which a node answered with the PDOs of the other phase alone.
    was_right : array of bool, shape (nodes,)
        Nodes that have sent a PDO of the right phase since they were last reported.
    """

    cycles: OpenCycles
    syncs: BusSyncs
    outstanding: Outstanding
    notes: SyncNotes
    counts: Integers
    foreign_syncs: Integers
    late_of_node: Integers
    missing_of_node: Integers
    heard: Flags
    strayed: Flags
    swapped_cycles: Integers
    was_right: Flags


#: Places of `Gathering.counts`.
ACCEPTED, LATE, DUPLICATE, MALFORMED, MISSING, FOREIGN = range(6)


@njit(cache=True, nogil=True)
def take_all(rows: npt.NDArray[np.uint8], bus: int, stamp_error_ns: int, table: FrameTable, state: Gathering) -> None:
    """Use the frames that arrived on a bus, in bus order.

    Parameters
    ----------
    rows : array of uint8, shape (frames, bytes of a FRAME)
    stamp_error_ns : int
        Bound of the error of the clock of their time stamps, `NO_STAMPS` if they have none.
    """
    (rows,), table, state = borrowed((rows,)), borrowed(table), borrowed(state)
    is_ordered = state.outstanding.is_ordered[bus]
    for place in range(rows.shape[0]):
        row = rows[place]
        flags = row[FLAGS_AT]
        can_id, ended_ns = field(row, CAN_ID_AT, 4), field(row, TIME_AT, 8)
        if can_id == SYNC_COB_ID and not flags & (ERROR | EXTENDED | REMOTE):
            if not flags & ECHO:
                # A foreign SYNC: nodes answer it outside the gateway's cycles, and in any phase.
                state.foreign_syncs[bus] += 1
                spoil_bus(bus, table, state.cycles)
                _ask(bus, EVERY, ended_ns, table, state)
            elif is_ordered:  # else `begin_unordered` has begun the cycle
                _begin(bus, int(row[DATA_AT]), ended_ns, stamp_error_ns, table, state)
        if flags & (ERROR | ECHO):
            continue
        frame = table.row_of[bus, can_id] if can_id <= BASE_ID_MASK else -1
        if frame < 0 or flags & (EXTENDED | REMOTE | FD) != table.flags[frame] & FD:
            state.counts[FOREIGN] += 1
        elif row[LENGTH_AT] != table.length[frame]:
            state.counts[MALFORMED] += 1
        else:
            _accept(bus, frame, row[DATA_AT:], ended_ns, stamp_error_ns, table, state)


@njit(cache=True, nogil=True)
def _begin(  # noqa: PLR0917  compiled functions take no keywords
    bus: int, counter: int, time_ns: int, stamp_error_ns: int, table: FrameTable, state: Gathering
) -> None:
    """Begin a cycle on a bus, at the echo of its SYNC."""
    if begin_on_bus(bus, counter, time_ns, state.syncs):
        spoil_bus(bus, table, state.cycles)
    now = state.syncs.counter[bus]
    if is_open(now, state.cycles):
        note_echo(slot_of(now), bus, time_ns, stamp_error_ns, state.notes)
    _ask(bus, state.cycles.phase[slot_of(now)], time_ns, table, state)


@njit(cache=True, nogil=True)
def begin_unordered(counter: int, sent_ns: int, table: FrameTable, state: Gathering) -> None:
    """Begin a cycle on the unordered buses; `sent_ns` is a time before its SYNC is handed over."""
    table, state = borrowed(table), borrowed(state)
    for bus in range(len(state.foreign_syncs)):
        if not state.outstanding.is_ordered[bus]:
            begin_on_bus(bus, counter, 0, state.syncs)
            note_echo(slot_of(counter), bus, sent_ns, NO_STAMPS, state.notes)
            _ask(bus, state.cycles.phase[slot_of(counter)], 0, table, state)


@njit(cache=True, nogil=True)
def _ask(bus: int, phase: int, time_ns: int, table: FrameTable, state: Gathering) -> None:
    """Use no frame after a SYNC that may answer an earlier one."""
    counter = state.syncs.counter[bus]
    slot = slot_of(counter)
    window_ns = state.syncs.window_ns[slot]
    if state.syncs.rests[slot]:
        rest(bus, time_ns, window_ns, table, state.outstanding)
        return
    ask(bus, phase, time_ns, window_ns, table, state.outstanding)
    if is_open(counter, state.cycles):
        for row in range(len(table.bus)):
            if table.bus[row] == bus:
                state.cycles.spoilt[slot, row] |= state.outstanding.may_be_old[row]


@njit(cache=True, nogil=True)
def _accept(  # noqa: PLR0917  compiled functions take no keywords
    bus: int,
    row: int,
    data: npt.NDArray[np.uint8],
    time_ns: int,
    stamp_error_ns: int,
    table: FrameTable,
    state: Gathering,
) -> None:
    """Use the data of a frame whose row in the table is known, if the frame is in time."""
    node = table.node[row]
    state.heard[node] = True
    is_owed = state.outstanding.owed[row] > 0
    came(row, time_ns, table, state.outstanding)
    counter = state.syncs.counter[bus]
    slot = slot_of(counter)
    is_right = table.phase[row] == state.cycles.phase[slot]
    if counter and not is_right:
        state.strayed[node] = True
    kind = LATE
    if is_right and is_open(counter, state.cycles):
        if not (state.cycles.spoilt[slot, row] or (stamp_error_ns != NO_STAMPS and state.outstanding.is_ordered[bus])):
            note_answer(slot, bus, time_ns + max(stamp_error_ns, 0), state.notes)
        if keep_frame(slot, bus, row, data, state.cycles):
            kind = ACCEPTED
        elif not is_owed:  # else the frame before it answered an older SYNC, and was late
            kind = DUPLICATE
    state.counts[kind] += 1
    state.late_of_node[node] += kind == LATE


@njit(cache=True, nogil=True)
def close_cycle(  # noqa: PLR0917  compiled functions take no keywords
    slot: int,
    leaves_out_doubtful: bool,
    block_of_sum: npt.NDArray[np.intp],
    bits: int,
    is_signed: bool,
    table: FrameTable,
    state: Gathering,
    raw: npt.NDArray[np.int32],
    valid: Flags,
) -> None:
    """Write the raw values of the sums of a cycle into `raw`, and clear `valid` for blocks that are not whole."""
    table, state = borrowed(table), borrowed(state)
    cycles = state.cycles
    is_right = np.zeros(len(state.strayed), np.bool_)
    for row in range(len(table.node)):
        if table.phase[row] != cycles.phase[slot]:
            continue
        node = table.node[row]
        if cycles.seen[slot, row]:
            is_right[node] = True
        else:
            state.counts[MISSING] += 1
            state.missing_of_node[node] += 1
        if cycles.seen[slot, row] and not (cycles.spoilt[slot, row] and leaves_out_doubtful):
            read_raw(cycles.payload[slot, row], table.gather[row], bits, is_signed, raw)
            continue
        for place in table.gather[row]:
            if place >= 0:
                valid[block_of_sum[place]] = False
    for node in range(len(is_right)):
        has_swapped = state.strayed[node] and not is_right[node]
        state.was_right[node] |= is_right[node]
        state.swapped_cycles[node] = state.swapped_cycles[node] + 1 if has_swapped else 0
        state.strayed[node] = False


class Collector:
    """Gathers the sums of the open cycles, `SLOTS` at most: `open` a cycle, `take` frames, `close` the cycle.

    On each bus the echo of the next SYNC ends a cycle. Frames before this echo belong to the old cycle, however late
    the host reads them. Frames after the echo do not.

    Cycles have a counter here (1 to 240), also where SYNC has none on the bus.

    Parameters
    ----------
    unordered : collection of int
        Numbers of the buses whose interface may echo a SYNC before it has been on the bus. A cycle ends there when the
        next SYNC is about to be sent.

    Attributes
    ----------
    late_of_node, missing_of_node : arrays of int64, shape (nodes,)
        `counts.late` and `counts.missing` of each node, in the order of the contract.
    heard : array of bool, shape (nodes,)
        Nodes that sent a TPDO since the array was last cleared.
    expected : array of bool, shape (nodes,)
        Nodes that a cycle waits for; frames of other nodes are used when they are in time.
    leaves_out_doubtful : bool
        Whether complete blocks are left out whose frames may be of another cycle.
    """

    def __init__(self, contract: Contract, unordered: Collection[int] = ()) -> None:
        nodes = len(contract.nodes)
        self.expected = np.ones(nodes, np.bool_)
        self.leaves_out_doubtful = True
        self._unordered = frozenset(unordered)
        self._contract, self._table, self._phi = contract, contract.table, contract.phi
        self._block_of_sum = np.ascontiguousarray(contract.phi.block_of_sum)
        self._node_of_block = np.repeat(np.arange(nodes), [node.blocks for node in contract.nodes])
        self._bus_of_node = np.array([node.bus for node in contract.nodes])
        self._proven = ProvenBlocks(contract.phi.blocks, SLOTS)
        self._begin_anew()
        # What runs in each cycle is compiled before the first.
        self.open(1)
        self.take(0, frames(0), None)
        self.close(1)
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Forget all frames."""
        contract = self._contract
        nodes, buses = len(contract.nodes), len(contract.layout.bus)
        self._times = SyncTimes(contract)
        self.late_of_node, self.missing_of_node, swapped_cycles = np.zeros((3, nodes), np.int64)
        self.heard, strayed, was_right = np.zeros((3, nodes), np.bool_)
        self._state = Gathering(
            cycles=new_cycles(contract),
            syncs=new_syncs(contract),
            outstanding=new_outstanding(contract, self._unordered),
            notes=self._times.notes,
            counts=np.zeros(6, np.int64),
            foreign_syncs=np.zeros(buses, np.int64),
            late_of_node=self.late_of_node,
            missing_of_node=self.missing_of_node,
            heard=self.heard,
            strayed=strayed,
            swapped_cycles=swapped_cycles,
            was_right=was_right,
        )

    @property
    def counts(self) -> FrameCounts:
        """What became of the frames."""
        counts = self._state.counts.tolist()
        return FrameCounts(
            accepted=counts[ACCEPTED],
            late=counts[LATE],
            duplicate=counts[DUPLICATE],
            malformed=counts[MALFORMED],
            missing=counts[MISSING],
            foreign=counts[FOREIGN],
        )

    def trust(self, blocks: slice, *, proven: bool) -> None:
        """Use the sums of `blocks` from the next cycle on if `proven`; else stop at once, in open cycles too."""
        self._proven.trust(blocks, proven=proven)
        nodes = self._node_of_block[blocks]
        if proven:
            prove(nodes, self._table, self._state.outstanding)
        else:
            is_ordered = self._state.outstanding.is_ordered[self._bus_of_node[nodes]]
            doubt(nodes[is_ordered], self._state.outstanding)

    def booted(self, node: int) -> None:
        """Take note of the boot-up message of a node, after the frames before this message."""
        doubt(np.array([node]), self._state.outstanding)

    def take_behind(self) -> list[int]:
        """Return, once, the places of the nodes that owe frames for long."""
        behind = self._state.outstanding.cycles_behind
        found = np.flatnonzero(behind >= BEHIND_CYCLES)
        behind[found] = 0
        return [int(node) for node in found]

    def take_swapped(self) -> list[tuple[int, bool]]:
        """Return, once, the nodes that answer each SYNC with the PDOs of the other phase.

        The place of each, and whether it has sent a PDO of the right phase since it was last reported.
        """
        found = np.flatnonzero(self._state.swapped_cycles >= SWAPPED_CYCLES)
        reported = list(zip(found.tolist(), self._state.was_right[found].tolist(), strict=True))
        self._state.swapped_cycles[found], self._state.was_right[found] = 0, False
        return reported

    def take_foreign_syncs(self, bus: int) -> int:
        """Return the number of foreign SYNCs on a bus since the last call."""
        count = int(self._state.foreign_syncs[bus])
        self._state.foreign_syncs[bus] = 0
        return count

    def open(self, counter: int, due_ns: int = 0, sent_ns: int | None = None, period_s: float | None = None) -> None:
        """Begin the cycle of SYNC `counter`, due at `due_ns`; call it at `sent_ns`, before this SYNC is sent.

        No cycle of the same slot (`slot_of`) may be open. The next SYNC is due after `period_s`, by default the
        layout's.
        """
        self._times.open(counter, due_ns, sent_ns)
        send_sync(counter, due_ns, period_s, self._state.syncs, rests=False)
        begin_cycle(counter, self.expected, self._table, self._state.cycles)
        if self._unordered:
            begin_unordered(counter, max(due_ns if sent_ns is None else sent_ns, 1), self._table, self._state)
        self._proven.begin(slot_of(counter))

    def rest(self, counter: int, due_ns: int, period_s: float | None) -> None:
        """Take note of a SYNC that asks for no frame of this contract; arguments as for `open`."""
        send_sync(counter, due_ns, period_s, self._state.syncs, rests=True)
        self._state.cycles.counter[slot_of(counter)] = 0

    def waiting(self, counter: int) -> Integers:
        """Return how many frames a cycle waits for, shape (buses,); a view."""
        waiting: Integers = self._state.cycles.waiting[slot_of(counter)]
        return waiting

    def is_settled(self, counter: int) -> bool:
        """Tell whether a cycle can be closed: every bus has sent all expected frames, or the next SYNC."""
        has_next = self._state.syncs.counter == next_counter(counter)
        return bool((has_next | (self.waiting(counter) == 0)).all())

    def take(self, bus: int, arrived: Frames, stamp_error_ns: int | None) -> None:
        """Use the frames that arrived on a bus, in bus order; the echo of a SYNC starts its cycle on the bus.

        `stamp_error_ns` is the bound of the error of the clock of their time stamps, None if they have none.
        """
        error_ns = NO_STAMPS if stamp_error_ns is None else stamp_error_ns
        take_all(frame_bytes(arrived), bus, error_ns, self._table, self._state)

    def lost(self, bus: int) -> None:
        """Take note that frames of a bus were lost.

        With one phase the lost frame may be a SYNC between two cycles. With two phases the answers to this SYNC are of
        the other phase, and those to the SYNC after it come when the older cycle of their phase is closed.
        """
        if self._contract.phases == 1:
            spoil_bus(bus, self._table, self._state.cycles)
        # A command to a node behind would be lost, too: it has some cycles when the bus is back.
        self._state.outstanding.cycles_behind[self._bus_of_node == bus] = 0

    def close(self, counter: int) -> Gathered:
        """End a cycle and return its sums."""
        slot = slot_of(counter)
        self._state.cycles.counter[slot] = 0
        valid, raw = self._proven.during(slot) & self._phi.has_sums, np.zeros(self._phi.shape[0], np.int32)
        packing = self._contract.packing
        of_sums = self._block_of_sum, packing.bits, packing.is_signed
        close_cycle(slot, self.leaves_out_doubtful, *of_sums, self._table, self._state, raw, valid)
        sums = packing.counts(raw)
        sums[~self._phi.sums_of_blocks(valid)] = 0
        return Gathered(sums, valid, self._times.close(counter), bool(valid[self._phi.has_sums].all()))
