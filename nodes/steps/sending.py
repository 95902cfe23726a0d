"""The frames of stepped nodes: when each node sends, what it has sent, and what became of that."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dbc.canopen import BASE_ID_MASK
from dbc.contract import Contract, PartTable
from dbc.dictionary import slot_offset_us
from dbc.frame import ECHO, ERROR, FD_BYTES, Frames, frames
from dbc.frame_fields import Bytes, Integers
from dbc.patch_filter import Floats
from dbc.steps import WORD_BYTES, keep_max, slot_byte, slot_cycle, write_word
from nodes.steps.stepping import (
    NO_COB_ID,
    Numbers,
    State,
    give_back,
    new_slots,
    new_state,
    rows_due,
    take_slots,
)
from shell.compiled import njit

#: Columns of `Senders.counts`.
SENT, REFUSED = range(2)


class Senders:
    """The nodes of a skin, of which some run here; a node is called by its place in the contract.

    Attributes
    ----------
    slots : Slots
    state : State
    counts : array of int64, shape (nodes, 2)
        Frames sent, and frames that found no room in the transmit queue.
    """

    def __init__(self, contract: Contract) -> None:
        self._contract, self._table = contract, contract.parts
        self._period_ns = round(contract.layout.sync.period_s * 1e9)
        self._port = np.array([contract.nodes[node].node_id for node in self._table.node], np.uint16)
        nodes, self._bus = len(contract.nodes), contract.table.bus
        self.slots = new_slots(nodes, len(contract.layout.bus), self._bus)
        self.state = self._new_state()
        self.counts = np.zeros((nodes, 2), np.int64)
        self._chosen = np.zeros(len(self._bus), np.int64)
        #: Frame of an identifier of each bus, -1 for all others.
        self._frame_of = np.full(self._table.row_of.shape, -1, np.intp)
        for node in range(nodes):
            self.reset(node)
        # Compiles what runs in every slot, so that no bus waits for it.
        nothing = np.zeros((1, contract.phi.block_size), np.float32)
        self.take_slots(0, nothing, nothing, np.zeros(1))
        give_back(0, self.slots, self.state)

    def _new_state(self) -> State:
        form = self._table.form
        return new_state(len(form), len(self._bus), int(form[:, 0].max()))

    def _frames(self, node: int) -> slice:
        """Return the frames of a node."""
        first, end = np.searchsorted(self._table.node, (node, node + 1)).tolist()
        return slice(first, end)

    # --- when a node sends ----------------------------------------------------------------------------------

    def reset(self, node: int) -> None:
        """Let a node send when the contract says."""
        contract = self._contract
        self.set_sending(node, contract.layout.steps.quiet, contract.slots)
        self.slots.offset_ns[node] = 1000 * slot_offset_us(contract, contract.nodes[node])

    def set_sending(self, node: int, quiet: float | None = None, slots: int | None = None) -> None:
        """Set 2031h:1 and :2 of a node."""
        if quiet is not None:
            self.slots.quiet[node] = np.float32(quiet)
        if slots is not None:
            self.slots.slots[node] = slots
            self.slots.cycle[node], self.slots.keep_max[node] = slot_cycle(slots), keep_max(slots)

    def set_operational(self, node: int, is_operational: bool) -> None:
        """Let a node send; it begins with all its sums. Or end that."""
        if is_operational and not self.slots.is_operational[node]:
            self.ask(node)
        self.slots.is_operational[node] = is_operational

    def set_cob_ids(self, node: int, cob_ids: Sequence[int]) -> None:
        """Set the identifier of each TPDO of a node, or `NO_COB_ID`."""
        mine, bus = self._frames(node), self._contract.nodes[node].bus
        self.slots.cob_id[mine] = cob_ids
        self._frame_of[bus] = -1
        used = np.flatnonzero((self._bus == bus) & (self.slots.cob_id != NO_COB_ID))
        self._frame_of[bus, self.slots.cob_id[used]] = used

    def ask(self, node: int) -> None:
        """Have all sums of a node set."""
        self.state.unset[self._frames(node)] = 0

    def is_asked(self, node: int) -> bool:
        """Tell whether sums of a node are still to be set."""
        mine, table = self._frames(node), self._table
        return bool((self.state.unset[mine] < table.form[table.part[mine], 3]).any())

    def forget(self, node: int) -> None:
        """Forget what a node has sent, as a reset does."""
        mine, fresh = self._frames(node), self._new_state()
        of_parts = slice(self._table.part[mine.start], self._table.part[mine.stop - 1] + self._table.parts[mine][0])
        for name, each in self.state._asdict().items():
            its = of_parts if name in {"known", "word"} else mine
            each[its] = getattr(fresh, name)[its]
        self.slots.under_way_ns[mine] = 0
        self.slots.is_operational[node] = False
        self.counts[node] = 0

    def word(self, node: int, part: int) -> int:
        """Return the newest word of a part of a node (2110h)."""
        return int(self.state.word[self._table.part[self._frames(node)][0] + part])

    def slot_byte(self, node: int) -> int:
        """Return 2022h of a node, that of its newest words; 0 before the first."""
        mine = self.state.slot[self._frames(node)]
        return int(slot_byte(mine[0])) if mine[0] >= 0 else 0

    # --- frames ---------------------------------------------------------------------------------------------

    @property
    def is_sending(self) -> bool:
        """Whether a controller may hold a frame, or its echo is to be read."""
        return bool(self.slots.under_way_ns.any())

    def take_sync(self, bus: int, counter: int, time_ns: int) -> None:
        """Begin the slots of a SYNC; one without counter has no slots."""
        self.slots.counter[bus], self.slots.sync_ns[bus] = counter, time_ns
        self.slots.done_ns[bus] = min(self.slots.done_ns[bus], time_ns - 1)

    def rows_due(self, now_ns: int) -> npt.NDArray[np.intp]:
        """Return the rows of the nodes whose slot has begun since the call of `take_slots` before."""
        return rows_due(now_ns, self._period_ns, self._table, self.slots)

    def take_slots(
        self, now_ns: int, sums_n: Floats, variance_n2: Floats, noise_n: Numbers
    ) -> tuple[Frames, npt.NDArray[np.intp]]:
        """Return the frames of the slots that have begun since the call before, and the bus of each.

        Sums, variances and noise are those of `nodes.steps.stepping.take_slots`.
        """
        table, of_boards = self._table, (sums_n, variance_n2, noise_n, self._contract.unit_n)
        count = take_slots(now_ns, self._period_ns, *of_boards, table, self.slots, self.state, self._chosen)
        chosen = self._chosen[: int(count)]
        burst = frames(len(chosen))
        burst["time_ns"], burst["port"], burst["can_id"] = now_ns, self._port[chosen], self.slots.cob_id[chosen]
        burst["length"], burst["flags"] = table.length[chosen], table.flags[chosen]
        burst["data"] = payloads(chosen, table, self.state)
        return burst, self._bus[chosen]

    def take_echoes(self, bus: int, arrived: Frames) -> tuple[int, int]:
        """Take note of the nodes' own frames; return how many were sent, and the number of other frames."""
        flags, frame = arrived["flags"], self._frame_of[bus][arrived["can_id"] & BASE_ID_MASK]
        is_own = (flags & ECHO != 0) & (frame >= 0)
        if not is_own.any():
            return 0, len(arrived)
        is_sent = is_own & (flags & ERROR == 0)
        self.slots.under_way_ns[frame[is_sent]] = 0
        np.add.at(self.counts[:, SENT], self._table.node[frame[is_sent]], 1)
        for each in frame[is_own & ~is_sent].tolist():
            give_back(each, self.slots, self.state)
        return int(np.count_nonzero(is_sent)), int(np.count_nonzero(~is_own))

    def refuse(self, bus: int, cob_id: int) -> None:
        """Take note of a frame that found no room in a transmit queue."""
        frame = int(self._frame_of[bus, cob_id])
        give_back(frame, self.slots, self.state)
        self.counts[self._table.node[frame], REFUSED] += 1


@njit(cache=True, nogil=True)
def payloads(chosen: Integers, table: PartTable, state: State) -> Bytes:
    """Return the bytes of the newest words of some frames, shape (frames, 64), with zeros after them."""
    made = np.zeros((len(chosen), FD_BYTES), np.uint8)
    for place, frame in enumerate(chosen):
        made[place, 0] = slot_byte(state.slot[frame])
        for each in range(table.parts[frame]):
            write_word(state.word[table.part[frame] + each], made[place, 1 + WORD_BYTES * each :])
    return made
