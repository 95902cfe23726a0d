"""From frames to one measurement: the frames of one SYNC, each used once, none of another cycle.

A frame is used when it comes from its own bus, has the length of its PDO, and belongs to the cycle of the newest SYNC
on that bus. Every other frame is counted by kind and not used.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.canopen import BASE_ID_MASK, SYNC_COB_ID
from dbc.codec import decode
from dbc.contract import PHASES, Contract, next_counter, phase_of
from dbc.frame import ECHO, ERROR, EXTENDED, FD, REMOTE, Frames
from skin.messages import FrameCounts

#: Two SYNCs whose ends are nearer than this part of a period are too close. The gateway itself keeps half a period.
CLOSE: Final = 0.4
#: A node whose phases are swapped for this many cycles in a row is reported.
SWAPPED_CYCLES: Final = 5


@dataclass(frozen=True)
class Gathered:
    """The sums of one cycle: `sums` int32 (m,), 0 where invalid; `valid` bool (blocks,)."""

    sums: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]

    @property
    def complete(self) -> bool:
        """Whether every block is valid."""
        return bool(self.valid.all())


class Collector:
    """Gathers the sums of the open cycles, at most one per phase: `open` a cycle, `take` frames, `close` the cycle.

    On each bus the echo of the next SYNC ends a cycle. Frames before this echo belong to the old cycle, however late
    the host reads them. Frames after the echo do not.
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
        self._packing = contract.packing
        self._payload = np.zeros((rows, int(contract.table.length.max())), np.uint8)
        self._seen = np.zeros(rows, np.bool_)
        self._spoilt = np.zeros(rows, np.bool_)
        self._of_phase = [np.flatnonzero(contract.table.phase == phase) for phase in range(PHASES)]
        #: Frame format of the TPDOs on each bus: classic or CAN FD.
        self._kind = [FD if bus.fd else 0 for bus in contract.layout.bus]
        #: Blocks whose node is proven now; blocks whose node was proven during the whole cycle of a phase.
        self._trusted = np.zeros(contract.phi.blocks, np.bool_)
        self._proven = np.zeros((PHASES, contract.phi.blocks), np.bool_)
        #: Buses with a foreign SYNC since the newest cycle was opened.
        self._disturbed = np.zeros(len(contract.layout.bus), np.bool_)
        #: Cycles in a row in which a node sent PDOs of the wrong phase only.
        self._swapped = np.zeros(len(contract.nodes), np.intp)
        self._strayed = np.zeros(len(contract.nodes), np.bool_)
        #: Nodes that a cycle waits for, by place in the contract; other nodes' frames are used when in time.
        self.expected = np.ones(len(contract.nodes), np.bool_)
        #: Counter of the SYNC whose cycle is open in a phase, 0 for none.
        self._gathering = np.zeros(PHASES, np.intp)
        self._awaited = np.zeros(rows, np.bool_)
        #: Frames that the cycle of a phase still waits for, by bus.
        self._waiting = np.zeros((PHASES, len(contract.layout.bus)), np.intp)
        #: When the newest SYNC ended on each bus, 0 if unknown, and the shortest time allowed to the next.
        self._sync_ns = [0] * len(contract.layout.bus)
        self._too_close_ns = round(CLOSE * contract.layout.sync.period_s * 1e9)
        #: Counter of the newest SYNC on each bus, 0 before the first.
        self._on_wire = [0] * len(contract.layout.bus)

    def trust(self, blocks: slice, *, proven: bool) -> None:
        """Use the sums of `blocks` from the next cycle on if `proven`; else stop at once, in open cycles too."""
        self._trusted[blocks] = proven
        if not proven:
            self._proven[:, blocks] = False

    @property
    def trusted(self) -> npt.NDArray[np.bool_]:
        """Blocks whose node is proven now, shape (blocks,)."""
        return self._trusted.copy()

    def take_swapped(self) -> list[int]:
        """Return, once, the places of the nodes that answer each SYNC with the PDOs of the other phase."""
        found = np.flatnonzero(self._swapped >= SWAPPED_CYCLES)
        self._swapped[found] = 0
        return [int(place) for place in found]

    def take_foreign_syncs(self, bus: int) -> int:
        """Return the number of foreign SYNCs on a bus since the last call."""
        count, self._foreign_syncs[bus] = self._foreign_syncs[bus], 0
        return count

    def open(self, counter: int) -> None:
        """Begin the cycle of SYNC `counter`; call it before this SYNC is sent."""
        phase = phase_of(counter)
        rows = self._of_phase[phase]
        # A bus without SYNC since this counter was last used is not in this cycle.
        self._on_wire = [0 if now == counter else now for now in self._on_wire]
        self._seen[rows] = False
        self._spoilt[rows] = self._disturbed[self._table.bus[rows]]
        self._disturbed[:] = False
        self._proven[phase] = self._trusted
        self._gathering[phase] = counter
        self._awaited[rows] = self.expected[self._table.node[rows]]
        awaited = rows[self._awaited[rows]]
        self._waiting[phase] = np.bincount(self._table.bus[awaited], minlength=self._waiting.shape[1])

    def is_settled(self, counter: int) -> bool:
        """Tell whether a cycle can be closed: every bus has sent all expected frames, or the next SYNC."""
        following = next_counter(counter)
        waiting = self._waiting[phase_of(counter)]
        return all(count == 0 or now == following for count, now in zip(waiting, self._on_wire, strict=True))

    def take(self, bus: int, arrived: Frames) -> None:
        """Use the frames that arrived on a bus, in bus order; the echo of a SYNC starts its cycle on the bus."""
        begin = 0
        is_sync = arrived["can_id"] == SYNC_COB_ID
        foreign = int((is_sync & (arrived["flags"] & (ERROR | ECHO | EXTENDED | REMOTE) == 0)).sum())
        if foreign:
            # A foreign SYNC: nodes have answered it outside the gateway's cycles.
            self._foreign_syncs[bus] += foreign
            self._spoil(bus)
        sent = is_sync & (arrived["flags"] & (ECHO | ERROR) == ECHO)
        for place in np.flatnonzero(sent):
            self._take(bus, arrived[begin:place])
            self._on_wire[bus] = int(arrived["data"][place, 0])
            self._check_spacing(bus, int(arrived["time_ns"][place]))
            begin = int(place) + 1
        self._take(bus, arrived[begin:])

    def close(self, counter: int) -> Gathered:
        """End a cycle and return its sums."""
        phase = phase_of(counter)
        rows = self._of_phase[phase]
        self._gathering[phase] = 0
        missing = rows[~self._seen[rows]]
        self.counts.missing += len(missing)
        np.add.at(self.missing_of_node, self._table.node[missing], 1)
        whole = self._seen[rows] & ~self._spoilt[rows]
        good, lost = rows[whole], self._table.gather[rows[~whole]]
        self._judge_phases(rows)
        valid = self._proven[phase].copy()
        valid[self._phi.block_of_sum[lost[lost >= 0]]] = False
        sums = np.zeros(self._phi.shape[0], np.int32)
        decode(self._payload[good], self._table.gather[good], self._packing, sums)
        sums[~self._phi.sums_of_blocks(valid)] = 0
        return Gathered(sums, valid)

    def _spoil(self, bus: int) -> None:
        """Use no sums of a bus in the open cycles, nor in the next cycle."""
        self._disturbed[bus] = True
        self._spoilt[self._table.bus == bus] = True

    def _check_spacing(self, bus: int, time_ns: int) -> None:
        """Spoil a bus whose SYNCs waited in the controller and end too close: sums may answer either SYNC."""
        last_ns, self._sync_ns[bus] = self._sync_ns[bus], time_ns
        if time_ns and last_ns and time_ns - last_ns < self._too_close_ns:
            self._spoil(bus)

    def _judge_phases(self, rows: npt.NDArray[np.intp]) -> None:
        """Count, for each node, the cycles in a row with PDOs of the wrong phase only."""
        is_right = np.zeros(len(self._strayed), np.bool_)
        is_right[self._table.node[rows[self._seen[rows]]]] = True
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
        self._accept(bus, row[whole], arrived["data"][whole, : self._payload.shape[1]])

    def _accept(self, bus: int, row: npt.NDArray[np.intp], payload: npt.NDArray[np.uint8]) -> None:
        self.heard[self._table.node[row]] = True
        cycle = self._gathering[self._table.phase[row]]
        in_time = (cycle != 0) & (cycle == self._on_wire[bus])
        self.counts.late += int(len(row) - in_time.sum())
        np.add.at(self.late_of_node, self._table.node[row[~in_time]], 1)
        if self._on_wire[bus]:
            other = self._table.phase[row] != phase_of(self._on_wire[bus])
            self._strayed[self._table.node[row[other]]] = True
        row, payload = row[in_time], payload[in_time]
        if not len(row):
            return
        first = np.zeros(len(row), np.bool_)
        first[np.unique(row, return_index=True)[1]] = True
        first &= ~self._seen[row]
        fresh = row[first]
        self._payload[fresh] = payload[first]
        self._seen[fresh] = True
        self._waiting[self._table.phase[row[0]], bus] -= self._awaited[fresh].sum()
        self.counts.accepted += len(fresh)
        if len(fresh) < len(row):
            self._again(row[~first], payload[~first])

    def _again(self, row: npt.NDArray[np.intp], payload: npt.NDArray[np.uint8]) -> None:
        """Count repeated frames; a repeated frame with other data (two nodes share a node-ID) spoils the block."""
        self.counts.duplicate += len(row)
        differs = (self._payload[row] != payload).any(axis=1)
        self._spoilt[row[differs]] = True
