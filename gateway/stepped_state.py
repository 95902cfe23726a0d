"""What the gateway knows of stepped nodes: the integers of every part (`dbc.steps`), and how far they are proven.

Every word tells by its count whether words before it were lost. After a loss all groups of the part are missing, until
sets have come of all of them, with no loss between. Steps move a part meanwhile: its sums are shown, and not valid. Two
words of a part with the same slot and count that differ, as of two nodes with one identifier, are a loss, too.

**What counts and slots prove.** The slots of a board's words rise, and it sends at most one in a slot. A step follows
within `SEQUENCE` slots, a set or check within the longest silence. So a step hides a loss only if its first byte stands
for a slot `SYNC_OVERFLOW` slots later, or a multiple of that: then the part seems that much too late, until a set or
check tells of the loss. A part without words for more than `Slots.silence` is forgotten. So a block that is wrong
is valid only if frames of its node come late by at least `dbc.steps.slot_cycle` less `Slots.silence`, and none of them
after a longer silence: 691 slots, 2.8 s by default.

**What silence proves.** The words tell how long their board may wait with the next one (`PartSums.wait`). A part
without words for that long is late, as a part whose newest word came late.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from bus.told import CAME, STAMP_ERROR
from dbc.contract import Contract, PartTable
from dbc.dictionary import slot_offset_us
from dbc.frame import DATA_AT, TIME_AT
from dbc.frame_fields import Bytes, Flags, Integers, field
from dbc.steps import (
    BAD,
    CHECK,
    COUNT,
    KEEP_MIN,
    LATE_SLOTS,
    PART_SUMS,
    SEQUENCE,
    SET,
    STEP,
    WORD_BYTES,
    Form,
    form_at,
    hash_of,
    kind_of,
    move,
    put,
    read_word,
)
from gateway.batch import NOTHING, OWN_SYNC, WRONG, Batch
from gateway.turn import wait_and_sort
from shell.compiled import borrowed, njit
from skin.sync_counter import SYNC_OVERFLOW

#: A time before all frames.
NEVER_NS: Final = -(1 << 62)
#: A word that is this number of slots ahead of the gateway's clock is not late by nearly all of them.
_AHEAD: Final = 3


class Slots(NamedTuple):
    """The slots of a skin.

    Attributes
    ----------
    per_sync : int
        From SYNC to SYNC.
    cycle : int
        After this number of slots their numbers come again.
    slot_ns : int
        Length of a slot.
    keep_max : int
        After this number of slots a silent board sends a check at the latest.
    jump : int
        Most slots by which a late SYNC sets the numbers of all boards back, and the next SYNC forward again.
    silence : int
        Longest silence of a part, slots.
    offset_ns, bus : arrays of int64, shape (blocks,)
        Place of a node in its slot, and its bus.
    """

    per_sync: int
    cycle: int
    slot_ns: int
    keep_max: int
    jump: int
    silence: int
    offset_ns: Integers
    bus: Integers


class PartSums(NamedTuple):
    """The sums of all parts of a skin, numbered as in `dbc.contract.PartTable`.

    Attributes
    ----------
    known : array of int64, shape (parts, PART_SUMS)
        Integers, in units of `Contract.unit_n`.
    word, word_count, slot, newest_ns : arrays of int64, shape (parts,)
        The newest word, its count, slot and end.
    wait : array of int64, shape (parts,)
        Slots after the newest word in which the next one is sent at the latest.
    missing, unknown : arrays of int64, shape (parts,)
        Groups, a bit each: of which no set has come since a loss; of which nothing is held.
    different : array of int64, shape (parts,)
        Checks that found other integers.
    is_late, has_changed : arrays of bool, shape (parts,)
        The newest word came late, or the next is late; sums are not yet shown (`gateway.block_states`).
    sync_ns, sync_slot : arrays of int64, shape (buses,)
        End of the newest SYNC of the gateway, and the number of the slot that it began.
    counts : array of int64
        Frames by `COUNTED`.
    """

    known: Integers
    word: Integers
    word_count: Integers
    slot: Integers
    newest_ns: Integers
    wait: Integers
    missing: Integers
    unknown: Integers
    different: Integers
    is_late: Flags
    has_changed: Flags
    sync_ns: Integers
    sync_slot: Integers
    counts: Integers


#: What `PartSums.counts` counts (`FrameCounts`). A frame with several words counts as that which is last here.
COUNTED: Final = ("accepted", "late", "after_gap", "duplicate", "malformed", "unproven", "foreign")
USED, LATE, AFTER_GAP, DUPLICATE, MALFORMED, UNPROVEN, FOREIGN = range(7)


def slots_of(contract: Contract) -> Slots:
    """Return the slots of a skin."""
    slot_ns = round(contract.layout.steps.slot_s * 1e9)
    offset_ns = np.array([1000 * slot_offset_us(contract, node) for node in contract.nodes], np.int64)
    bus = np.array([node.bus for node in contract.nodes], np.int64)
    per_sync, cycle, most = contract.slots, contract.slot_cycle, contract.keep_max
    jump = min(per_sync, cycle // 4)  # boards take a greater one for a silence
    return Slots(per_sync, cycle, slot_ns, most, jump, most + jump + LATE_SLOTS, offset_ns, bus)


def new_sums(contract: Contract) -> PartSums:
    """Return the state of a gateway that has received nothing."""
    parts, buses = len(contract.parts.block), len(contract.layout.bus)
    known, of_parts = np.zeros((parts, PART_SUMS), np.int64), np.zeros((8, parts), np.int64)
    of_buses, counts = np.zeros((2, buses), np.int64), np.zeros(len(COUNTED), np.int64)
    state = PartSums._make([known, *of_parts, *np.zeros((2, parts), np.bool_), *of_buses, counts])
    state.sync_ns[:] = NEVER_NS
    for part in range(parts):
        forget(part, contract.parts, state)
    return state


@njit(cache=True, nogil=True)
def forget(part: int, table: PartTable, state: PartSums) -> None:
    """Hold nothing of a part any more."""
    state.known[part] = 0
    state.missing[part] = state.unknown[part] = (1 << form_at(table.form, part).groups) - 1
    state.newest_ns[part], state.has_changed[part] = NEVER_NS, True


def take_all(batch: Batch, known: Any) -> tuple[int, int]:
    """Use the frames of a bus, in bus order.

    Parameters
    ----------
    known : shell.compiled.Held
        Blocks whose frames may be used (array of bool, shape (blocks,)), `Slots`, `PartTable`, and `PartSums`.

    Returns
    -------
    newest_ns, taken_ns : int
        When the newest frame that was used ended, or `NEVER_NS`; how long ago its node had begun with it.
    """
    newest_ns, taken_ns = take_rows(batch.rows, batch.places, batch.bus, known)
    return newest_ns, taken_ns


@njit(cache=True, nogil=True)
def take_rows(rows: Bytes, places: Integers, bus: int, known: Any) -> tuple[int, int]:
    """Do what `take_all` does."""
    (rows, places), (is_proven, slots, table, state) = borrowed((rows, places)), borrowed(known.value)
    newest_ns, taken_ns = NEVER_NS, 0
    for place in range(rows.shape[0]):
        row, frame = rows[place], places[place]
        ended_ns = field(row, TIME_AT, 8)
        if frame == OWN_SYNC:
            state.sync_ns[bus], state.sync_slot[bus] = ended_ns, (int(row[DATA_AT]) - 1) * slots.per_sync
        elif frame < NOTHING:
            state.counts[MALFORMED if frame == WRONG else FOREIGN] += 1
        if frame < 0:
            continue
        first, verdict, since_ns = table.part[frame], USED, ended_ns - state.sync_ns[bus]
        if not is_proven[table.block[first]]:
            state.counts[UNPROVEN] += 1
            continue
        now = state.sync_slot[bus] + since_ns // slots.slot_ns if state.sync_ns[bus] != NEVER_NS else -1
        for each in range(table.parts[frame]):
            word = read_word(row[DATA_AT + 1 + WORD_BYTES * each :])
            found, age = _take_word(first + each, int(row[DATA_AT]) - 1, word, ended_ns, now, slots, table, state)
            verdict = max(verdict, found)
        state.counts[verdict] += 1
        if verdict <= AFTER_GAP and ended_ns >= newest_ns:
            begun_ns = age * slots.slot_ns + since_ns % slots.slot_ns
            newest_ns, taken_ns = ended_ns, max(0, begun_ns - slots.offset_ns[table.block[first]])
    return newest_ns, taken_ns


@njit(cache=True, nogil=True)
def take_turn(rest_ns: int, wait_ns: int, known: Any, turn: Any, news: Integers) -> int:
    """Wait for frames and use those of calm buses; `turn` is a `gateway.turn.Turn` that is held.

    Write into `news`, shape (buses, 3), what `take_all` returns and the bound of the error of the time stamps; return
    how many buses are not calm.
    """
    now = borrowed(turn.value)
    restless = wait_and_sort(rest_ns, wait_ns, borrowed(known.value)[2], now)
    for bus in range(now.is_calm.size):
        told = now.intake.told[bus]
        news[bus, 0], news[bus, 2] = NEVER_NS, told[STAMP_ERROR]
        if now.is_calm[bus] and told[CAME]:
            news[bus, 0], news[bus, 1] = take_rows(now.intake.rows[bus, : told[CAME]], now.places[bus], bus, known)
    return restless


@njit(cache=True, nogil=True)
def _take_word(  # noqa: PLR0917  compiled functions take no keywords
    part: int, low: int, word: int, ended_ns: int, now: int, slots: Slots, table: PartTable, state: PartSums
) -> tuple[int, int]:
    """Use a word whose slot is `low` modulo `SYNC_OVERFLOW`; return its kind of count, and its age in slots."""
    form = form_at(table.form, part)
    kind, group, count, high, data = kind_of(word, form)
    if kind == BAD:
        return MALFORMED, 0
    if ended_ns - state.newest_ns[part] > slots.silence * slots.slot_ns:
        forget(part, table, state)
    known, is_first = state.known[part, : form.sums], state.newest_ns[part] == NEVER_NS
    every = (1 << form.groups) - 1
    ahead = (low - state.slot[part]) % SYNC_OVERFLOW
    if not is_first and ahead == 0 and (count - state.word_count[part]) % SEQUENCE == 0:
        if word != state.word[part]:  # of another node, or of a slot whose first byte is the same
            state.missing[part] = every
        return DUPLICATE, 0
    slot = state.slot[part] + ahead if kind == STEP else high * SYNC_OVERFLOW + low
    counts, most = (SEQUENCE, SEQUENCE) if kind == STEP else (COUNT, slots.silence)
    is_next = (count - state.word_count[part] - 1) % counts == 0
    is_next &= not is_first and 0 < (slot - state.slot[part]) % slots.cycle <= most
    if not is_next:
        state.missing[part], state.wait[part] = every, slots.keep_max
    since = (slot - state.slot[part]) % slots.cycle if is_next else 0
    state.wait[part] = _wait(kind, group, since, state.word[part], state.wait[part], slots, form)
    if kind == STEP:
        move(known, group, data, form)
    elif kind == SET:
        put(known, group, data, form)
        state.missing[part] &= ~(1 << group)
        state.unknown[part] &= ~(1 << group)
    elif not state.missing[part] and hash_of(known) != data:
        state.different[part] += 1
        state.missing[part] = every
    age = (now - slot) % slots.cycle
    age = 0 if age > slots.cycle - _AHEAD else age
    # A step tells its count modulo `SEQUENCE` alone: after a loss the least is taken, and the next set tells.
    state.word_count[part] += (count - state.word_count[part]) % counts
    state.word[part], state.slot[part], state.newest_ns[part] = word, slot % slots.cycle, ended_ns
    state.is_late[part], state.has_changed[part] = age > LATE_SLOTS or now < 0, True
    if not (is_next or is_first):
        return AFTER_GAP, age
    return (LATE if state.is_late[part] else USED), age


@njit(cache=True, nogil=True)
def _wait(  # noqa: PLR0917  compiled functions take no keywords
    kind: int, group: int, since: int, before: int, wait: int, slots: Slots, form: Form
) -> int:
    """Return the longest wait of a board after a word that came `since` slots after the word `before`; 0: unknown.

    A step or a set that is worth its bits begins the waits anew. A check doubles the wait, which was no longer than
    `since`, unless it is that after many words. Sets of all groups in turn, as after a request, change nothing.
    """
    if kind == CHECK:
        return min(2 * (min(wait, since) if since >= KEEP_MIN else wait), slots.keep_max)
    if kind == SET:
        kind_before, group_before = kind_of(before, form)[:2]
        if since == 0 or group == 0 or (kind_before == SET and group_before == group - 1):
            return wait
    return KEEP_MIN
