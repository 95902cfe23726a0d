"""From frames to one measurement: the frames of one SYNC, each used once, none of another cycle.

A frame is used when it comes from its own bus, has the length of its PDO, and belongs to the cycle of the newest SYNC
on that bus. Every other frame is counted by kind and not used.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import FrameCounts
from dbc.canopen import BASE_ID_MASK, SYNC_COB_ID
from dbc.codec import decode
from dbc.contract import Contract
from dbc.dictionary import STOCK_WINDOW_RATIO
from dbc.frame import ECHO, ERROR, EXTENDED, FD, REMOTE, Frames
from gateway.bus_syncs import BusSyncs
from gateway.open_cycles import SLOTS, OpenCycles, Rows, slot_of
from gateway.outstanding import Outstanding
from gateway.proven_blocks import ProvenBlocks
from gateway.sync_times import SampledTimes, SyncTimes
from skin.sync_counter import next_counter

#: A node whose phases are swapped for this many cycles in a row is reported.
SWAPPED_CYCLES: Final = 5


@dataclass(frozen=True)
class Gathered:
    """One cycle: `sums` int32 (m,), 0 where invalid; `valid` bool (blocks,); `times` of the sampling.

    A block without sums is never valid; a cycle is `complete` if all other blocks are.
    """

    sums: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    times: SampledTimes
    complete: bool


class SwappedPhases:
    """Counts, for each node, the cycles in a row in which it answered with the PDOs of the other phase alone."""

    def __init__(self, nodes: int) -> None:
        self._cycles = np.zeros(nodes, np.intp)
        self._strayed = np.zeros(nodes, np.bool_)

    def stray(self, nodes: Rows) -> None:
        """Take note of nodes that sent a PDO of the other phase."""
        self._strayed[nodes] = True

    def end_cycle(self, right: Rows) -> None:
        """End a cycle in which the nodes `right` sent PDOs of its phase."""
        is_right = np.zeros(len(self._strayed), np.bool_)
        is_right[right] = True
        self._cycles = np.where(self._strayed & ~is_right, self._cycles + 1, 0)
        self._strayed[:] = False

    def take(self) -> list[int]:
        """Return, once, the nodes that `SWAPPED_CYCLES` have counted."""
        found = np.flatnonzero(self._cycles >= SWAPPED_CYCLES)
        self._cycles[found] = 0
        return [int(node) for node in found]


class Collector:
    """Gathers the sums of the open cycles, `SLOTS` at most: `open` a cycle, `take` frames, `close` the cycle.

    On each bus the echo of the next SYNC ends a cycle. Frames before this echo belong to the old cycle, however late
    the host reads them. Frames after the echo do not.

    Cycles have a counter here (1 to 240), also where SYNC has none on the bus.

    Attributes
    ----------
    counts : FrameCounts
    late_of_node, missing_of_node : arrays of int64, shape (nodes,)
        `counts.late` and `counts.missing` of each node, in the order of the contract.
    heard : array of bool, shape (nodes,)
        Nodes that sent a TPDO since the array was last cleared.
    expected : array of bool, shape (nodes,)
        Nodes that a cycle waits for; frames of other nodes are used when they are in time.
    leaves_out_doubtful : bool
        Whether complete blocks are left out whose frames may be of another cycle.
    """

    def __init__(self, contract: Contract) -> None:
        nodes, buses = len(contract.nodes), len(contract.layout.bus)
        self.counts = FrameCounts()
        self.late_of_node, self.missing_of_node = np.zeros((2, nodes), np.int64)
        self.heard, self.expected = np.zeros(nodes, np.bool_), np.ones(nodes, np.bool_)
        self.leaves_out_doubtful = True
        self._contract, self._table, self._phi = contract, contract.table, contract.phi
        self._of_phase = [np.flatnonzero(contract.table.phase == phase) for phase in range(contract.phases)]
        self._node_of_block = np.repeat(np.arange(nodes), [node.blocks for node in contract.nodes])
        #: Frame format of the TPDOs on each bus: classic or CAN FD.
        self._kind = [FD if bus.fd else 0 for bus in contract.layout.bus]
        self._cycles = OpenCycles(contract)
        self._proven = ProvenBlocks(contract.phi.blocks, SLOTS)
        self._syncs, self._times = BusSyncs(contract), SyncTimes(contract)
        #: With one phase: frames of earlier cycles that may still come. With two, the phase tells.
        self._outstanding = Outstanding(contract) if contract.phases == 1 else None
        self._swapped = SwappedPhases(nodes)
        #: By bus: foreign SYNCs since the last `take_foreign_syncs`, and the bound of the error of the clock of the
        #: newest time stamps, None without.
        self._foreign_syncs = [0] * buses
        self._stamp_error_ns: list[int | None] = [None] * buses

    def trust(self, blocks: slice, *, proven: bool) -> None:
        """Use the sums of `blocks` from the next cycle on if `proven`; else stop at once, in open cycles too."""
        self._proven.trust(blocks, proven=proven)
        if self._outstanding is not None:
            change = self._outstanding.prove if proven else self._outstanding.doubt
            change(self._node_of_block[blocks])

    def take_swapped(self) -> list[int]:
        """Return, once, the places of the nodes that answer each SYNC with the PDOs of the other phase."""
        return self._swapped.take()

    def take_foreign_syncs(self, bus: int) -> int:
        """Return the number of foreign SYNCs on a bus since the last call."""
        count, self._foreign_syncs[bus] = self._foreign_syncs[bus], 0
        return count

    def open(self, counter: int, due_ns: int = 0, sent_ns: int | None = None, period_s: float | None = None) -> None:
        """Begin the cycle of SYNC `counter`, due at `due_ns`; call it at `sent_ns`, before this SYNC is sent.

        No cycle of the same slot (`slot_of`) may be open. The next SYNC is due after `period_s`, by default the
        layout's.
        """
        self._times.open(counter, due_ns, sent_ns)
        self._syncs.send(counter, due_ns, period_s, rests=False)
        rows = self._rows_of(counter)
        self._cycles.begin(counter, rows[self.expected[self._table.node[rows]]])
        self._proven.begin(slot_of(counter))

    def rest(self, counter: int, due_ns: int, period_s: float | None) -> None:
        """Take note of a SYNC that asks for no frame of this contract; arguments as for `open`."""
        self._syncs.send(counter, due_ns, period_s, rests=True)
        self._cycles.end(counter)

    def waiting(self, counter: int) -> npt.NDArray[np.intp]:
        """Return how many frames a cycle waits for, shape (buses,); a view."""
        return self._cycles.waiting(counter)

    def is_settled(self, counter: int) -> bool:
        """Tell whether a cycle can be closed: every bus has sent all expected frames, or the next SYNC."""
        following, waiting = next_counter(counter), self.waiting(counter)
        return all(count == 0 or now == following for count, now in zip(waiting, self._syncs.counter, strict=True))

    def take(self, bus: int, arrived: Frames, stamp_error_ns: int | None) -> None:
        """Use the frames that arrived on a bus, in bus order; the echo of a SYNC starts its cycle on the bus.

        `stamp_error_ns` is the bound of the error of the clock of their time stamps, None if they have none.
        """
        self._stamp_error_ns[bus] = stamp_error_ns
        begin = 0
        is_sync = (arrived["can_id"] == SYNC_COB_ID) & (arrived["flags"] & (ERROR | EXTENDED | REMOTE) == 0)
        for place in np.flatnonzero(is_sync):
            self._take(bus, arrived[begin:place])
            time_ns = int(arrived["time_ns"][place])
            begin = int(place)
            if arrived["flags"][place] & ECHO:
                self._begin(bus, int(arrived["data"][place, 0]), time_ns)
            else:
                # A foreign SYNC: nodes answer it outside the gateway's cycles.
                self._foreign_syncs[bus] += 1
                self._cycles.spoil_bus(bus)
            self._ask(bus, time_ns)
        self._take(bus, arrived[begin:])

    def lost(self, bus: int) -> None:
        """Take note that frames of a bus were lost; with one phase, the lost frame may be a SYNC between two cycles."""
        if self._outstanding is not None:
            self._cycles.spoil_bus(bus)

    def close(self, counter: int) -> Gathered:
        """End a cycle and return its sums."""
        slot, rows = slot_of(counter), self._rows_of(counter)
        self._cycles.end(counter)
        seen = self._cycles.seen[slot, rows]
        missing = rows[~seen]
        self.counts.missing += len(missing)
        np.add.at(self.missing_of_node, self._table.node[missing], 1)
        whole = seen & ~(self._cycles.spoilt(counter, rows) & self.leaves_out_doubtful)
        good, lost = rows[whole], self._table.gather[rows[~whole]]
        self._swapped.end_cycle(self._table.node[rows[seen]])
        valid = self._proven.during(slot) & self._phi.has_sums
        valid[self._phi.block_of_sum[lost[lost >= 0]]] = False
        sums = np.zeros(self._phi.shape[0], np.int32)
        decode(self._cycles.payload[slot, good], self._table.gather[good], self._contract.packing, sums)
        sums[~self._phi.sums_of_blocks(valid)] = 0
        return Gathered(sums, valid, self._times.close(counter), bool(valid[self._phi.has_sums].all()))

    def _rows_of(self, counter: int) -> Rows:
        """Return the rows that are sent in the cycle of a SYNC."""
        return self._of_phase[self._contract.phase_of(counter)]

    def _begin(self, bus: int, counter: int, time_ns: int) -> None:
        """Begin a cycle on a bus, at the echo of its SYNC."""
        if self._syncs.begin(bus, counter, time_ns):
            self._cycles.spoil_bus(bus)
        self._times.echo(self._syncs.counter[bus], bus, time_ns, self._stamp_error_ns[bus])

    def _ask(self, bus: int, time_ns: int) -> None:
        """With one phase: use no frame in the new cycle that may be of an earlier one."""
        if self._outstanding is None:
            return
        counter, window_ns = self._syncs.counter[bus], round(STOCK_WINDOW_RATIO * self._syncs.period_ns(bus))
        if self._syncs.rests(bus):
            self._outstanding.rest(bus, time_ns, window_ns)
            return
        doubtful = self._outstanding.ask(bus, time_ns, window_ns)
        if self._cycles.is_open(counter):
            self._cycles.spoil(counter, doubtful)

    def _take(self, bus: int, arrived: Frames) -> None:
        arrived = arrived[arrived["flags"] & (ERROR | ECHO) == 0]
        if not len(arrived):
            return
        kind = arrived["flags"] & (EXTENDED | REMOTE | FD)
        strange = (kind != self._kind[bus]) | (arrived["can_id"] > BASE_ID_MASK)
        row = self._table.row_of[bus, np.where(strange, 0, arrived["can_id"])]
        ours = row >= 0
        self.counts.foreign += int(len(row) - ours.sum())
        row, arrived = row[ours], arrived[ours]
        whole = arrived["length"] == self._table.length[row]
        self.counts.malformed += int(len(row) - whole.sum())
        payload = arrived["data"][whole, : self._cycles.payload.shape[2]]
        self._accept(bus, row[whole], payload, arrived["time_ns"][whole])

    def _accept(self, bus: int, row: Rows, payload: npt.NDArray[np.uint8], time_ns: npt.NDArray[np.int64]) -> None:
        self.heard[self._table.node[row]] = True
        if self._outstanding is not None:
            self._outstanding.came(row)
        counter = self._syncs.counter[bus]
        right = self._table.phase[row] == self._contract.phase_of(counter)
        in_time = right & self._cycles.is_open(counter)
        self.counts.late += int(len(row) - in_time.sum())
        np.add.at(self.late_of_node, self._table.node[row[~in_time]], 1)
        if counter:
            self._swapped.stray(self._table.node[row[~right]])
        row, payload = row[in_time], payload[in_time]
        if not len(row):
            return
        if self._stamp_error_ns[bus] is None:
            self._times.answer(counter, bus, int(time_ns[in_time][0]))
        fresh = self._cycles.take(counter, bus, row, payload)
        self.counts.accepted += fresh
        self.counts.duplicate += len(row) - fresh
