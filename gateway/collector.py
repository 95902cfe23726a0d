"""From frames to one measurement: the frames of one SYNC, each used once, none of another cycle.

A frame is used when it comes from its own bus, has the length of its PDO, and belongs to the cycle of the newest SYNC
on that bus. Every other frame is counted by kind and not used.
"""

from collections import deque
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
from gateway.outstanding import Outstanding
from gateway.sync_times import SampledTimes, SyncTimes
from skin.sync_counter import next_counter

#: Two SYNCs whose ends are nearer than this part of a period are too close. The gateway itself keeps half a period.
CLOSE: Final = 0.4
#: Cycles that are gathered at once: frames of a cycle may be read after the next SYNC was sent.
SLOTS: Final = 2
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


class Collector:
    """Gathers the sums of the open cycles, `SLOTS` at most: `open` a cycle, `take` frames, `close` the cycle.

    On each bus the echo of the next SYNC ends a cycle. Frames before this echo belong to the old cycle, however late
    the host reads them. Frames after the echo do not.

    Cycles have a counter here (1 to 240), also where SYNC has none on the bus: an echo without counter is that of the
    newest SYNC that was due at its time.
    """

    def __init__(self, contract: Contract) -> None:
        self.counts = FrameCounts()
        #: `counts.late` and `counts.missing` of each node, by place in the contract.
        self.late_of_node = np.zeros(len(contract.nodes), np.int64)
        self.missing_of_node = np.zeros(len(contract.nodes), np.int64)
        #: Foreign SYNCs on each bus since the last `take_foreign_syncs`.
        self._foreign_syncs = [0] * len(contract.layout.bus)
        #: Nodes that sent a TPDO since the array was last cleared.
        self.heard = np.zeros(len(contract.nodes), np.bool_)
        self._table = contract.table
        self._phi = contract.phi
        rows = len(contract.table.cob_id)
        self._contract = contract
        self._packing = contract.packing
        #: By slot and row: data, whether it came, and whether its sums are not to be used.
        self._payload = np.zeros((SLOTS, rows, int(contract.table.length.max())), np.uint8)
        self._seen = np.zeros((SLOTS, rows), np.bool_)
        self._spoilt = np.zeros((SLOTS, rows), np.bool_)
        self._of_phase = [np.flatnonzero(contract.table.phase == phase) for phase in range(contract.phases)]
        #: With one phase: frames of earlier cycles that may still come.
        self._outstanding = Outstanding(contract) if contract.phases == 1 else None
        #: Frame format of the TPDOs on each bus: classic or CAN FD.
        self._kind = [FD if bus.fd else 0 for bus in contract.layout.bus]
        #: Blocks whose node is proven now; blocks whose node was proven during the whole cycle of a slot.
        self._proven_now = np.zeros(contract.phi.blocks, np.bool_)
        #: Whether complete blocks are left out whose frames may be of another cycle.
        self.leaves_out_doubtful = True
        self._proven_all_cycle = np.zeros((SLOTS, contract.phi.blocks), np.bool_)
        self._node_of_block = np.repeat(np.arange(len(contract.nodes)), [node.blocks for node in contract.nodes])
        #: Buses with a foreign SYNC since the newest cycle was opened.
        self._disturbed = np.zeros(len(contract.layout.bus), np.bool_)
        #: Cycles in a row in which a node sent PDOs of the wrong phase only.
        self._swapped = np.zeros(len(contract.nodes), np.intp)
        self._strayed = np.zeros(len(contract.nodes), np.bool_)
        #: Nodes that a cycle waits for, by place in the contract; other nodes' frames are used when in time.
        self.expected = np.ones(len(contract.nodes), np.bool_)
        #: Counter of the SYNC whose cycle is open in a slot, 0 for none.
        self._gathering = np.zeros(SLOTS, np.intp)
        self._awaited = np.zeros((SLOTS, rows), np.bool_)
        #: Frames that the cycle of a slot still waits for, by bus.
        self._waiting = np.zeros((SLOTS, len(contract.layout.bus)), np.intp)
        #: Counter and due time of the newest SYNCs, the oldest first.
        self._due: deque[tuple[int, int]] = deque(maxlen=SLOTS)
        #: When the newest SYNC ended on each bus, 0 if unknown, and the shortest time allowed to the next.
        self._sync_ns = [0] * len(contract.layout.bus)
        #: By slot: time to the next SYNC, and whether the SYNC asks for the frames of this contract.
        self._period_ns = [round(contract.layout.sync.period_s * 1e9)] * SLOTS
        self._rests = [False] * SLOTS
        self._times = SyncTimes(contract)
        #: Of each bus: bound of the error of the clock of the newest time stamps, None without.
        self._stamp_error_ns: list[int | None] = [None] * len(contract.layout.bus)
        #: Counter of the newest SYNC on each bus, 0 before the first.
        self._on_wire = [0] * len(contract.layout.bus)

    def trust(self, blocks: slice, *, proven: bool) -> None:
        """Use the sums of `blocks` from the next cycle on if `proven`; else stop at once, in open cycles too."""
        self._proven_now[blocks] = proven
        if not proven:
            self._proven_all_cycle[:, blocks] = False
        if self._outstanding is not None:
            change = self._outstanding.prove if proven else self._outstanding.doubt
            change(self._node_of_block[blocks])

    @property
    def trusted(self) -> npt.NDArray[np.bool_]:
        """Blocks whose node is proven now, shape (blocks,)."""
        return self._proven_now.copy()

    def take_swapped(self) -> list[int]:
        """Return, once, the places of the nodes that answer each SYNC with the PDOs of the other phase."""
        found = np.flatnonzero(self._swapped >= SWAPPED_CYCLES)
        self._swapped[found] = 0
        return [int(place) for place in found]

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
        slot, rows = slot_of(counter), self._rows_of(counter)
        self._note(counter, due_ns, period_s, rests=False)
        self._seen[slot] = False
        self._spoilt[slot] = self._disturbed[self._table.bus]
        self._disturbed[:] = False
        self._proven_all_cycle[slot] = self._proven_now
        self._gathering[slot] = counter
        self._awaited[slot] = False
        self._awaited[slot, rows] = self.expected[self._table.node[rows]]
        self._waiting[slot] = np.bincount(self._table.bus[self._awaited[slot]], minlength=self._waiting.shape[1])

    def rest(self, counter: int, due_ns: int, period_s: float | None) -> None:
        """Take note of a SYNC that asks for no frame of this contract; arguments as for `open`."""
        self._note(counter, due_ns, period_s, rests=True)
        self._gathering[slot_of(counter)] = 0

    def _note(self, counter: int, due_ns: int, period_s: float | None, *, rests: bool) -> None:
        # A bus without SYNC since this counter was last used is not in this cycle.
        self._on_wire = [0 if now == counter else now for now in self._on_wire]
        self._due.append((counter, due_ns))
        slot = slot_of(counter)
        self._rests[slot] = rests
        if period_s is not None:
            self._period_ns[slot] = round(period_s * 1e9)

    def is_settled(self, counter: int) -> bool:
        """Tell whether a cycle can be closed: every bus has sent all expected frames, or the next SYNC."""
        following = next_counter(counter)
        waiting = self._waiting[slot_of(counter)]
        return all(count == 0 or now == following for count, now in zip(waiting, self._on_wire, strict=True))

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
                self._spoil(bus)
                self._ask(bus, time_ns)
        self._take(bus, arrived[begin:])

    def lost(self, bus: int) -> None:
        """Take note that frames of a bus were lost; with one phase, the lost frame may be a SYNC between two cycles."""
        if self._outstanding is not None:
            self._spoil(bus)

    def close(self, counter: int) -> Gathered:
        """End a cycle and return its sums."""
        slot, rows = slot_of(counter), self._rows_of(counter)
        self._gathering[slot] = 0
        missing = rows[~self._seen[slot, rows]]
        self.counts.missing += len(missing)
        np.add.at(self.missing_of_node, self._table.node[missing], 1)
        whole = self._seen[slot, rows] & ~(self._spoilt[slot, rows] & self.leaves_out_doubtful)
        good, lost = rows[whole], self._table.gather[rows[~whole]]
        self._judge_phases(rows[self._seen[slot, rows]])
        valid = self._proven_all_cycle[slot] & self._phi.has_sums
        valid[self._phi.block_of_sum[lost[lost >= 0]]] = False
        sums = np.zeros(self._phi.shape[0], np.int32)
        decode(self._payload[slot, good], self._table.gather[good], self._packing, sums)
        sums[~self._phi.sums_of_blocks(valid)] = 0
        return Gathered(sums, valid, self._times.close(counter), bool(valid[self._phi.has_sums].all()))

    def _spoil(self, bus: int) -> None:
        """Use no sums of a bus in the open cycles, nor in the next cycle."""
        self._disturbed[bus] = True
        self._spoilt[:, self._table.bus == bus] = True

    def _rows_of(self, counter: int) -> npt.NDArray[np.intp]:
        """Return the rows that are sent in the cycle of a SYNC."""
        return self._of_phase[self._contract.phase_of(counter)]

    def _begin(self, bus: int, counter: int, time_ns: int) -> None:
        """Begin a cycle on a bus, at the echo of its SYNC; `counter` is 0 in a SYNC without counter."""
        before = self._on_wire[bus]
        counter = counter or self._counter_at(time_ns)
        if counter == before:
            self._spoil(bus)  # its SYNC was on the bus already
        self._on_wire[bus] = counter
        self._times.echo(counter, bus, time_ns, self._stamp_error_ns[bus])
        self._check_spacing(bus, time_ns, self._period_ns[slot_of(before or counter)])
        self._ask(bus, time_ns)

    def _counter_at(self, time_ns: int) -> int:
        """Return the counter of the newest SYNC that was due at a time, 0 before the first."""
        newest = self._due[0][0] if self._due else 0
        for counter, due_ns in self._due:
            if not time_ns or due_ns <= time_ns:
                newest = counter
        return newest

    def _ask(self, bus: int, time_ns: int) -> None:
        """With one phase: use no frame in the new cycle that may be of an earlier one."""
        if self._outstanding is not None:
            slot = slot_of(self._on_wire[bus])
            window_ns = round(STOCK_WINDOW_RATIO * self._period_ns[slot])
            if self._rests[slot]:
                self._outstanding.rest(bus, time_ns, window_ns)
                return
            doubtful = self._outstanding.ask(bus, time_ns, window_ns)
            if self._on_wire[bus] and self._gathering[slot] == self._on_wire[bus]:
                self._spoilt[slot, doubtful] = True

    def _check_spacing(self, bus: int, time_ns: int, period_ns: int) -> None:
        """Spoil a bus whose SYNCs waited in the controller and end too close: sums may answer either SYNC."""
        last_ns, self._sync_ns[bus] = self._sync_ns[bus], time_ns
        if time_ns and last_ns and time_ns - last_ns < CLOSE * period_ns:
            self._spoil(bus)

    def _judge_phases(self, came: npt.NDArray[np.intp]) -> None:
        """Count, for each node, the cycles in a row with PDOs of the wrong phase only; `came` are the right ones."""
        is_right = np.zeros(len(self._strayed), np.bool_)
        is_right[self._table.node[came]] = True
        self._swapped = np.where(self._strayed & ~is_right, self._swapped + 1, 0)
        self._strayed[:] = False

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
        self._accept(bus, row[whole], arrived["data"][whole, : self._payload.shape[2]], arrived["time_ns"][whole])

    def _accept(
        self,
        bus: int,
        row: npt.NDArray[np.intp],
        payload: npt.NDArray[np.uint8],
        time_ns: npt.NDArray[np.int64],
    ) -> None:
        self.heard[self._table.node[row]] = True
        if self._outstanding is not None:
            self._outstanding.came(row)
        counter = self._on_wire[bus]
        slot, right = slot_of(counter), self._table.phase[row] == self._contract.phase_of(counter)
        in_time = right & (counter != 0 and self._gathering[slot] == counter)
        self.counts.late += int(len(row) - in_time.sum())
        np.add.at(self.late_of_node, self._table.node[row[~in_time]], 1)
        if counter:
            self._strayed[self._table.node[row[~right]]] = True
        row, payload = row[in_time], payload[in_time]
        if not len(row):
            return
        if self._stamp_error_ns[bus] is None:
            self._times.answer(counter, bus, int(time_ns[in_time][0]))
        first = np.zeros(len(row), np.bool_)
        first[np.unique(row, return_index=True)[1]] = True
        first &= ~self._seen[slot, row]
        fresh = row[first]
        self._payload[slot, fresh] = payload[first]
        self._seen[slot, fresh] = True
        self._waiting[slot, bus] -= self._awaited[slot, fresh].sum()
        self.counts.accepted += len(fresh)
        if len(fresh) < len(row):
            self._again(slot, row[~first], payload[~first])

    def _again(self, slot: int, row: npt.NDArray[np.intp], payload: npt.NDArray[np.uint8]) -> None:
        """Count repeated frames; a repeated frame with other data (two nodes share a node-ID) spoils the block."""
        self.counts.duplicate += len(row)
        differs = (self._payload[slot, row] != payload).any(axis=1)
        self._spoilt[slot, row[differs]] = True


def slot_of(counter: int) -> int:
    """Return the slot of a cycle; with two phases it is the phase."""
    return (counter - 1) % SLOTS
