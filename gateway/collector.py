"""From frames to one measurement: the frames of one SYNC, each used once, none of another cycle.

A frame names its cycle by the SYNC counter in its first byte. The frame is used in the open cycle of this counter, if
it comes from its own bus and has the length of its PDO. Every other frame is counted by kind and not used.

**What the counter proves.** The counter comes again after 240 SYNCs. A node, an interface and a bus hand on the frames
of one identifier in the order in which they were made. So a frame that is late by 240 SYNCs comes after its identifier
was silent for `SILENCE` or more: then the next frames are doubtful, until after each of `PROVING` SYNCs exactly one
has come, and named an open cycle. A node that goes on after it hung sends what it held back one frame after the other,
and not one for each SYNC. A wrong sum is used only of a node that is late by a multiple of 240 SYNCs for good, and
sends one frame for each SYNC: the node has to hold back 240 frames of an identifier, 2.4 s at 100 Hz.

**Turns.** With `sync.turns` > 1 a cycle brings a part of the sums. A measurement has the newest of every sum; a block
is valid if each of its frames came in the newest cycle of its turn.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.told import CAME, NO_STAMPS, STAMP_ERROR
from canskin.messages import FrameCounts
from dbc.codec import read_raw
from dbc.contract import Contract, FrameTable
from dbc.frame import DATA_AT, TIME_AT, frames
from dbc.frame_fields import Bytes, Flags, Integers, field
from gateway.batch import NOTHING, OTHER_SYNC, OWN_SYNC, STRANGE, Batch, batch_of
from gateway.open_cycles import SLOTS, OpenCycles, begin_cycle, is_open, keep_frame, new_cycles, slot_of, spoil_bus
from gateway.proven_blocks import ProvenBlocks
from gateway.sync_times import SampledTimes, SyncNotes, SyncTimes, note_answer, note_echo
from gateway.turn import wait_and_sort
from shell.compiled import Held, borrowed, hold, njit
from skin.sync_counter import SYNC_OVERFLOW

#: SYNCs without a frame that names an open cycle, after which the next frames of an identifier are doubtful.
SILENCE: Final = SYNC_OVERFLOW // 2
#: SYNCs, each answered by one frame, after which frames are not doubtful any more.
PROVING: Final = 2
#: Age of sums that never came, or that are not to be used: in no turn is a sum so old.
_NEVER: Final = SYNC_OVERFLOW


@dataclass(frozen=True)
class Gathered:
    """One cycle: `sums` int32 (m,), 0 where invalid; `valid` bool (blocks,); `times` of the sampling.

    A block without sums is never valid; a cycle is `complete` if all others of nodes that are not optional are.
    """

    sums: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    times: SampledTimes
    complete: bool


class Answers(NamedTuple):
    """What each identifier sent, by row of `Contract.table`.

    Attributes
    ----------
    came, silent : arrays of int64, shape (rows,)
        Frames since the newest SYNC; and SYNCs since a frame that named an open cycle.
    doubtful : array of int64, shape (rows,)
        For how many SYNCs a single frame has to come before frames are used; 0: they are used.
    turn : array of int64, shape (rows,)
        Turn of the newest frame, also of one that came after its cycle: a stack that counts SYNCs exchanges its turns
        when it misses a SYNC, and its frames then come when no cycle waits for them.
    age : array of int64, shape (rows,)
        How many cycles the sums are old that are held.
    """

    came: Integers
    silent: Integers
    doubtful: Integers
    turn: Integers
    age: Integers


class Gathering(NamedTuple):
    """What the frames of all buses have told.

    Attributes
    ----------
    cycles, answers, notes
        See their classes.
    counts : array of int64, shape (6,)
        By `ACCEPTED` to `FOREIGN`, see `FrameCounts`.
    late_of_node, missing_of_node : arrays of int64, shape (nodes,)
    heard, twice : arrays of bool, shape (nodes,)
        Nodes that sent a TPDO, and those of which a frame came twice with other sums.
    expected : array of bool, shape (nodes,)
        Nodes that a cycle waits for.
    raw : array of int32, shape (m,)
        Raw values of the sums that are held.
    """

    cycles: OpenCycles
    answers: Answers
    notes: SyncNotes
    counts: Integers
    late_of_node: Integers
    missing_of_node: Integers
    heard: Flags
    twice: Flags
    expected: Flags
    raw: npt.NDArray[np.int32]


#: Integers of `Gathering.counts`.
ACCEPTED, LATE, DUPLICATE, MALFORMED, MISSING, FOREIGN = range(6)


@njit(cache=True, nogil=True)
def take_all(  # noqa: PLR0917  compiled functions take no keywords
    rows: Bytes, places: Integers, bus: int, stamp_error_ns: int, turns: int, held: Any
) -> None:
    """Use the frames that arrived on a bus, in bus order.

    Parameters
    ----------
    rows, places : arrays
        See `gateway.batch.Batch`.
    stamp_error_ns : int
        Bound of the error of the clock of their time stamps, `NO_STAMPS` if they have none.
    held : shell.compiled.Held
        `FrameTable` and `Gathering`.
    """
    (rows, places), (table, state) = borrowed((rows, places)), borrowed(held.value)
    for place in range(rows.shape[0]):
        row, frame = rows[place], places[place]
        if frame == NOTHING:
            continue
        ended_ns = field(row, TIME_AT, 8)
        if frame in (OWN_SYNC, OTHER_SYNC):
            is_other = frame == OTHER_SYNC
            _take_sync(bus, int(row[DATA_AT]), is_other, ended_ns, stamp_error_ns, table, state)
            state.counts[FOREIGN] += is_other
        elif frame < 0:
            state.counts[FOREIGN if frame == STRANGE else MALFORMED] += 1
        else:
            _accept(bus, frame, row[DATA_AT:], ended_ns, stamp_error_ns, turns, table, state)


@njit(cache=True, nogil=True)
def take_turn(rest_ns: int, wait_ns: int, turns: int, held: Any, turn: Any) -> int:
    """Wait for frames and use those of calm buses; `turn` is a `gateway.turn.Turn` that is held.

    Return how many buses are not calm.
    """
    now = borrowed(turn.value)
    restless = wait_and_sort(rest_ns, wait_ns, borrowed(held.value)[0], now)
    for bus in range(now.is_calm.size):
        told = now.intake.told[bus]
        if now.is_calm[bus] and told[CAME]:
            take_all(now.intake.rows[bus, : told[CAME]], now.places[bus], bus, told[STAMP_ERROR], turns, held)
    return restless


@njit(cache=True, nogil=True)
def _take_sync(  # noqa: PLR0917  compiled functions take no keywords
    bus: int,
    counter: int,
    is_foreign: bool,
    time_ns: int,
    stamp_error_ns: int,
    table: FrameTable,
    state: Gathering,
) -> None:
    """Take note of a SYNC on a bus: when the gateway's own ended; of a foreign SYNC, which counter its answers have."""
    cycles = state.cycles
    if is_foreign:
        if 1 <= counter <= SYNC_OVERFLOW and not is_open(counter, cycles):
            cycles.tainted[bus, counter] = True
    elif not is_open(counter, cycles) or note_echo(slot_of(counter), bus, time_ns, stamp_error_ns, state.notes):
        return
    # Its answers have the counter of an open cycle, or a SYNC came twice.
    spoil_bus(bus, table, cycles)


@njit(cache=True, nogil=True)
def _accept(  # noqa: PLR0917  compiled functions take no keywords
    bus: int,
    row: int,
    data: npt.NDArray[np.uint8],
    time_ns: int,
    stamp_error_ns: int,
    turns: int,
    table: FrameTable,
    state: Gathering,
) -> None:
    """Use the data of a frame whose row in the table is known, if its cycle is open."""
    node, counter, answers = table.node[row], int(data[0]), state.answers
    state.heard[node] = True
    answers.came[row] += 1
    answers.turn[row] = (counter - 1) % turns
    kind = LATE
    if is_open(counter, state.cycles):
        slot = slot_of(counter)
        answers.silent[row] = 0
        state.cycles.spoilt[slot, row] |= answers.doubtful[row] > 0
        was_spoilt = state.cycles.spoilt[slot, row]
        if not was_spoilt:
            note_answer(slot, bus, time_ns + max(stamp_error_ns, 0), state.notes)
        if not keep_frame(slot, bus, row, data, state.cycles):
            kind = DUPLICATE
            state.twice[node] |= state.cycles.spoilt[slot, row] and not was_spoilt
        elif not answers.doubtful[row]:
            kind = ACCEPTED
    state.counts[kind] += 1
    state.late_of_node[node] += kind == LATE


@njit(cache=True, nogil=True)
def count_answers(answers: Answers) -> None:
    """Find out, at a SYNC, of which identifiers the next frames are doubtful."""
    for row in range(len(answers.came)):
        if answers.doubtful[row] and answers.came[row]:
            is_one = answers.came[row] == 1 and not answers.silent[row]
            answers.doubtful[row] = answers.doubtful[row] - 1 if is_one else PROVING
        answers.came[row] = 0
        answers.silent[row] += 1
        if answers.silent[row] > SILENCE:
            answers.doubtful[row] = PROVING


@njit(cache=True, nogil=True)
def open_cycle(counter: int, turn: int, held: Any) -> None:
    """Begin the cycle of a SYNC, which waits for the frames of a turn; `held` as for `take_all`."""
    table, state = borrowed(held.value)
    count_answers(state.answers)
    begin_cycle(counter, (state.answers.turn == turn) & state.expected[table.node], table, state.cycles)


@njit(cache=True, nogil=True)
def is_settled(counter: int, held: Any) -> bool:
    """Tell whether a cycle can be closed: every bus has sent all expected frames, or a frame of the next cycle."""
    _, state = borrowed(held.value)
    slot = slot_of(counter)
    for bus in range(state.cycles.passed.shape[1]):
        if state.cycles.waiting[slot, bus] and not state.cycles.passed[slot, bus]:
            return False
    return True


@njit(cache=True, nogil=True)
def close_cycle(  # noqa: PLR0917  compiled functions take no keywords
    slot: int,
    turn: int,
    turns: int,
    block_of_sum: npt.NDArray[np.intp],
    packing: tuple[int, bool, int, int],
    held: Any,
    proven: Flags,
    valid: Flags,
    sums: npt.NDArray[np.int32],
) -> None:
    """Keep the sums of a cycle of proven nodes, clear `valid` for blocks that are not whole, and write all `sums`.

    Parameters
    ----------
    packing : tuple
        Bits, whether signed, offset and scale of `dbc.packing.Packing`.
    held : shell.compiled.Held
        As for `take_all`.
    """
    (bits, is_signed, offset, scale), (table, state) = packing, borrowed(held.value)
    cycles, age = state.cycles, state.answers.age
    cycles.counter[slot] = 0
    for row in range(len(table.node)):
        is_proven = proven[block_of_sum[table.gather[row, 0]]]
        age[row] = min(age[row] + 1, _NEVER) if is_proven else _NEVER
        if not cycles.seen[slot, row]:
            if state.answers.turn[row] == turn:
                state.counts[MISSING] += 1
                state.missing_of_node[table.node[row]] += 1
        elif is_proven and not cycles.spoilt[slot, row]:
            read_raw(cycles.payload[slot, row], table.gather[row], bits, is_signed, state.raw)
            age[row] = 0
        if age[row] >= turns:
            for place in table.gather[row]:
                if place >= 0:
                    valid[block_of_sum[place]] = False
    for place in range(sums.size):
        sums[place] = (state.raw[place] - offset) * scale if valid[block_of_sum[place]] else 0


class Collector:
    """Gathers the sums of the open cycles, `SLOTS` at most: `open` a cycle, `take` frames, `close` the cycle.

    Parameters
    ----------
    early_echoes : collection of int
        Numbers of the buses whose interface may echo a SYNC before it has been on the bus.

    Attributes
    ----------
    late_of_node, missing_of_node : arrays of int64, shape (nodes,)
        `counts.late` and `counts.missing` of each node, in the order of the contract.
    heard, twice : arrays of bool, shape (nodes,)
        Nodes that sent a TPDO, and those of which a frame came twice with other sums, since the array was last cleared.
    expected : array of bool, shape (nodes,)
        Nodes that a cycle waits for; frames of other nodes are used when they are in time.
    """

    def __init__(self, contract: Contract, early_echoes: Collection[int] = ()) -> None:
        self.expected = np.ones(len(contract.nodes), np.bool_)
        packing = contract.packing
        self._packing = packing.bits, packing.is_signed, packing.offset, packing.scale
        self._contract, self._table, self._phi = contract, contract.table, contract.phi
        self._early_echoes = early_echoes
        self._block_of_sum = np.ascontiguousarray(contract.phi.block_of_sum)
        self._proven = ProvenBlocks(contract.phi.blocks, SLOTS)
        self._begin_anew()
        # What runs in each cycle is compiled before the first.
        self.open(1)
        self.take(batch_of(frames(0), 0, self._table), None)
        self.is_settled(1)
        self.close(1)
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Forget all frames."""
        contract, rows = self._contract, len(self._table.bus)
        self._times = SyncTimes(contract, self._early_echoes)
        self.late_of_node, self.missing_of_node = np.zeros((2, len(contract.nodes)), np.int64)
        self.heard, self.twice = np.zeros((2, len(contract.nodes)), np.bool_)
        came, silent, doubtful = np.zeros((3, rows), np.int64)
        turn = self._table.turn.astype(np.int64)
        self._state = Gathering(
            cycles=new_cycles(contract),
            answers=Answers(came, silent, doubtful, turn, np.full(rows, _NEVER, np.int64)),
            notes=self._times.notes,
            counts=np.zeros(6, np.int64),
            late_of_node=self.late_of_node,
            missing_of_node=self.missing_of_node,
            heard=self.heard,
            twice=self.twice,
            expected=self.expected,
            raw=np.zeros(self._phi.shape[0], np.int32),
        )
        self._held = hold((self._table, self._state))

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

    def open(self, counter: int, due_ns: int = 0, sent_ns: int | None = None) -> None:
        """Begin the cycle of SYNC `counter`, due at `due_ns`; call it at `sent_ns`, before this SYNC is sent.

        No cycle of the same slot (`slot_of`) may be open.
        """
        self._times.open(counter, due_ns, sent_ns)
        open_cycle(counter, self._contract.turn_of(counter), self._held)
        self._proven.begin(slot_of(counter))

    def waiting(self, counter: int) -> Integers:
        """Return how many frames a cycle waits for, shape (buses,); a view."""
        waiting: Integers = self._state.cycles.waiting[slot_of(counter)]
        return waiting

    def is_settled(self, counter: int) -> bool:
        """Tell whether a cycle can be closed: every bus has sent all expected frames, or a frame of the next cycle."""
        return is_settled(counter, self._held)

    def take(self, batch: Batch, stamp_error_ns: int | None) -> None:
        """Use the frames that arrived on a bus, in bus order.

        `stamp_error_ns` is the bound of the error of the clock of their time stamps, None if they have none.
        """
        error_ns = NO_STAMPS if stamp_error_ns is None else stamp_error_ns
        take_all(batch.rows, batch.places, batch.bus, error_ns, self._contract.turns, self._held)

    def turn(self, rest_ns: int, wait_ns: int, turn: Held) -> int:
        """Wait for frames and use those of calm buses, see `gateway.turn`; return how many buses are not calm."""
        return take_turn(rest_ns, wait_ns, self._contract.turns, self._held, turn)

    def lost(self, bus: int) -> None:
        """Take note that frames of a bus were lost, a foreign SYNC perhaps."""
        spoil_bus(bus, self._table, self._state.cycles)

    def close(self, counter: int) -> Gathered:
        """End a cycle and return its sums; cycles are closed in the order of their SYNCs."""
        slot, sums = slot_of(counter), np.empty(self._phi.shape[0], np.int32)
        proven = self._proven.during(slot)
        valid = proven & self._phi.has_sums
        close_cycle(
            slot,
            self._contract.turn_of(counter),
            self._contract.turns,
            self._block_of_sum,
            self._packing,
            self._held,
            proven,
            valid,
            sums,
        )
        return Gathered(sums, valid, self._times.close(counter), bool(valid[self._contract.needed].all()))
