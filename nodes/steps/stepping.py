"""What a board sends in its slot: the step or set that takes the most from what receivers do not know, or a check."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.contract import PartTable
from dbc.frame_fields import Flags, Integers
from dbc.patch_filter import Floats
from dbc.steps import (
    CHECK_EVERY,
    COUNT,
    KEEP_MIN,
    NOISE_RATIO,
    SCALES,
    SEQUENCE,
    SET_SUMS,
    VARIANCE_RATIO,
    Form,
    check_word,
    form_at,
    limits,
    set_word,
    step_word,
)
from shell.compiled import borrowed, njit

#: `Slots.cob_id` of a frame that is never sent.
NO_COB_ID: Final = 0
#: Time until a frame is given up for lost whose echo does not come.
LOST_NS: Final = 500_000_000
#: In place of the scale of a step: a set takes more from the difference.
_NO_STEP: Final = -1

Numbers = npt.NDArray[np.float64]


class State(NamedTuple):
    """What boards have sent. The parts of a frame are sent together, so they have the same counts.

    Attributes
    ----------
    known : array of int64, shape (parts, sums)
        The integers that a receiver holds which got every word.
    word : array of int64, shape (parts,)
        The newest word.
    sent, slot, keep, unchecked, unset : arrays of int64, shape (frames,)
        Words sent, modulo `COUNT`; slot of the newest, -1 before the first; slots without a word after which a check is
        sent; words since the newest check; the next group that is set whatever it is worth, or the number of groups.
    """

    known: Integers
    word: Integers
    sent: Integers
    slot: Integers
    keep: Integers
    unchecked: Integers
    unset: Integers


def new_state(parts: int, frames: int, sums: int) -> State:
    """Return the state of boards that have sent nothing, with at most `sums` sums of a part."""
    sent, unchecked, unset = np.zeros((3, frames), np.int64)
    slot, keep = np.full(frames, -1, np.int64), np.full(frames, KEEP_MIN, np.int64)
    known, word = np.zeros((parts, sums), np.int64), np.zeros(parts, np.int64)
    return State(known, word, sent, slot, keep, unchecked, unset)


@njit(cache=True, nogil=True)
def whole(sums_n: Floats, unit_n: float, form: Form, into: Integers) -> None:
    """Write the sums of a part in whole units, halves to even."""
    for place in range(form.sums):
        least, most = limits(place, form)
        units = np.rint(np.float64(sums_n[place]) / unit_n)
        into[place] = int(min(float(most), max(float(least), units)))


@njit(cache=True, nogil=True)
def threshold(  # noqa: PLR0917  compiled functions take no keywords
    variance_n2: Floats, noise_n: float, taxels: int, unit_n: float, quiet: float, form: Form
) -> float:
    """Return what a word of a part has to take from the squared difference, square units: below 0 if `quiet` is 0.

    Parameters
    ----------
    variance_n2 : array of float32, shape (sums,)
        Of the sums of the part.
    noise_n : float
        Of a board of `taxels` taxels.
    """
    if quiet == 0:
        return -1.0
    variance = 0.0
    for place in range(form.sums):
        variance += np.float64(variance_n2[place])
    share_n = NOISE_RATIO * noise_n
    worth_n2 = form.sums * taxels * (share_n * share_n) + VARIANCE_RATIO * variance
    return quiet * (worth_n2 / (unit_n * unit_n) + form.sums)


@njit(cache=True, nogil=True)
def offer(  # noqa: PLR0917  compiled functions take no keywords
    frame: int,
    first: int,
    last: int,
    wanted: Integers,
    least: float,
    slot: int,
    cycle: int,
    keep_max: int,
    forms: Integers,
    state: State,
) -> bool:
    """Write the words of a frame's parts, `first` to `last` - 1, to the state; tell whether the frame is to be sent.

    Parameters
    ----------
    wanted : array of int64, shape (parts, sums)
        The sums of all parts in whole units.
    least : float
        Sum of `threshold` over the parts of the frame.
    slot, cycle, keep_max : int
        Number of the slot; `dbc.steps.slot_cycle` and `keep_max` of the board.
    forms : array of int64, shape (parts, 5)
        The form of each part.
    """
    is_set = state.unset[frame] < forms[first, 3]
    is_check = not is_set and state.unchecked[frame] >= CHECK_EVERY
    since = (slot - state.slot[frame]) % cycle
    scale, group = np.empty((2, last - first), np.int64)
    if is_set:
        scale[:], group[:] = _NO_STEP, state.unset[frame]
        state.unset[frame] += 1
    elif not is_check:
        is_check = _choose(first, wanted, since <= SEQUENCE, forms, state, scale, group) <= least
        if not is_check:
            state.keep[frame] = KEEP_MIN
        elif since < state.keep[frame]:
            return False
    if is_check:
        state.keep[frame] = min(2 * state.keep[frame], keep_max)
    for part in range(first, last):
        each, known, form = part - first, state.known[part], form_at(forms, part)
        if is_check:
            state.word[part] = check_word(known[: form.sums], state.sent[frame], slot, form)
        elif scale[each] == _NO_STEP:
            for place in range(SET_SUMS * group[each], min(form.sums, SET_SUMS * (group[each] + 1))):
                known[place] = wanted[part, place]
            state.word[part] = set_word(group[each], known, state.sent[frame], slot, form)
        else:
            state.word[part] = _step(wanted[part], known, scale[each], state.sent[frame], form)
    state.sent[frame] = (state.sent[frame] + 1) % COUNT
    state.slot[frame] = slot
    state.unchecked[frame] = 0 if is_check else state.unchecked[frame] + 1
    return True


@njit(cache=True, nogil=True)
def _choose(  # noqa: PLR0917  compiled functions take no keywords
    first: int, wanted: Integers, may_step: bool, forms: Integers, state: State, scale: Integers, group: Integers
) -> int:
    """Write scale and group of the best words from part `first` on; return what they take from squared differences."""
    gain = 0
    for each in range(scale.size):
        part = first + each
        taken, scale[each], group[each] = _best(wanted[part], state.known[part], may_step, form_at(forms, part))
        gain += taken
    return gain


@njit(cache=True, nogil=True)
def _step(wanted: Integers, known: Integers, scale: int, sent: int, form: Form) -> int:
    """Move what is known by a step, and return its word."""
    digits = np.empty(form.sums, np.int64)
    for place in range(form.sums):
        digits[place] = _digit(wanted[place] - known[place], SCALES[scale], form)
        known[place] += digits[place] * SCALES[scale]
    return int(step_word(digits, scale, sent, form))


@njit(cache=True, nogil=True)
def _digit(difference: int, scale: int, form: Form) -> int:
    """Return the digit of a step that brings an integer nearest to what is wanted."""
    size = min(form.radix // 2, (2 * abs(difference) + scale) // (2 * scale))
    return size if difference > 0 else -size


@njit(cache=True, nogil=True)
def _best(wanted: Integers, known: Integers, may_step: bool, form: Form) -> tuple[int, int, int]:
    """Return what the best word takes from the squared difference, its scale or `_NO_STEP`, and the group to set."""
    total, group, of_group = 0, 0, -1
    for each in range(form.groups):
        found = 0
        for place in range(SET_SUMS * each, min(form.sums, SET_SUMS * (each + 1))):
            found += (wanted[place] - known[place]) ** 2
        total += found
        if found > of_group:
            group, of_group = each, found
    best, left = _NO_STEP, total - of_group
    if may_step:
        for scale in range(len(SCALES)):
            error = 0
            for place in range(form.sums):
                difference = wanted[place] - known[place]
                error += (difference - SCALES[scale] * _digit(difference, SCALES[scale], form)) ** 2
            # A set has to be better; among steps the first of the best is taken.
            if error < left or (best == _NO_STEP and error == left):
                best, left = scale, error
    return total - left, best, group


class Slots(NamedTuple):
    """When the boards of a skin send.

    Attributes
    ----------
    row : array of int64, shape (nodes,)
        Where the samples of a node are.
    is_operational : array of bool, shape (nodes,)
    quiet : array of float64, shape (nodes,)
        2031h:1, as REAL32 holds it.
    slots, offset_ns, cycle, keep_max : arrays of int64, shape (nodes,)
        2031h:2 and :3, and `dbc.steps.slot_cycle` and `keep_max` of these slots.
    sync_ns, counter, done_ns : arrays of int64, shape (buses,)
        When the newest SYNC came, its counter, 0 before the first, and until when the slots are done.
    bus : array of int64, shape (frames,)
    cob_id : array of int64, shape (frames,)
        Identifier, or `NO_COB_ID`.
    under_way_ns : array of int64, shape (frames,)
        Until when the controller may hold a frame, 0 for none.
    """

    row: Integers
    is_operational: Flags
    quiet: Numbers
    slots: Integers
    offset_ns: Integers
    cycle: Integers
    keep_max: Integers
    sync_ns: Integers
    counter: Integers
    done_ns: Integers
    bus: Integers
    cob_id: Integers
    under_way_ns: Integers


def new_slots(nodes: int, buses: int, bus: Integers) -> Slots:
    """Return the slots of boards that do nothing yet; `bus` is that of each frame."""
    row, slots, offset_ns, cycle, keep_max = np.zeros((5, nodes), np.int64)
    sync_ns, counter, done_ns = np.zeros((3, buses), np.int64)
    cob_id, under_way_ns = np.zeros((2, len(bus)), np.int64)
    off, quiet = np.zeros(nodes, np.bool_), np.zeros(nodes)
    of_nodes, of_buses = (row, off, quiet, slots, offset_ns, cycle, keep_max), (sync_ns, counter, done_ns)
    return Slots(*of_nodes, *of_buses, bus, cob_id, under_way_ns)


@njit(cache=True, nogil=True)
def slots_since(now_ns: int, period_ns: int, frame: int, node: int, slots: Slots) -> int:
    """Return the number of slots since the SYNC, if a slot of the frame has begun since the call before, else -1."""
    bus = slots.bus[frame]
    if not slots.is_operational[node] or slots.cob_id[frame] == NO_COB_ID or slots.counter[bus] == 0:
        return -1
    of_sync, start_ns = slots.slots[node], slots.sync_ns[bus] + slots.offset_ns[node]
    since = (now_ns - start_ns) * of_sync // period_ns
    is_new = 0 <= since < 2 * of_sync and since != (slots.done_ns[bus] - start_ns) * of_sync // period_ns
    return since if is_new else -1


@njit(cache=True, nogil=True)
def rows_due(now_ns: int, period_ns: int, table: PartTable, slots: Slots) -> npt.NDArray[np.intp]:
    """Return the rows of the boards that have to decide now."""
    table, slots = borrowed(table), borrowed(slots)
    due = np.zeros(slots.row.size, np.bool_)
    for frame in range(table.node.size):
        if slots_since(now_ns, period_ns, frame, table.node[frame], slots) >= 0:
            due[slots.row[table.node[frame]]] = True
    return np.flatnonzero(due)


@njit(cache=True, nogil=True)
def take_slots(  # noqa: PLR0917  compiled functions take no keywords
    now_ns: int,
    period_ns: int,
    sums_n: Floats,
    variance_n2: Floats,
    noise_n: Numbers,
    unit_n: float,
    table: PartTable,
    slots: Slots,
    state: State,
    chosen: Integers,
) -> int:
    """Let each board decide whose slot has begun since the call before; write the frames to send to `chosen`.

    A board whose controller still holds its frame leaves the slot out. So does a board whose newest word has the same
    number, or one of less than a period later, because a SYNC was late: the slots of its words rise.

    Parameters
    ----------
    period_ns : int
        From SYNC to SYNC.
    sums_n, variance_n2 : arrays of float32, shape (rows, sums)
        In the order of the parts; variances of the boards of `rows_due` count.
    noise_n : array of float64, shape (rows,)

    Returns
    -------
    int
        Number of frames to send.
    """
    table, slots, state = borrowed(table), borrowed(slots), borrowed(state)
    wanted, count, taxels = np.empty_like(state.known), 0, sums_n.shape[1]
    for frame in range(table.node.size):
        node, bus = table.node[frame], slots.bus[frame]
        since, of_sync, cycle = slots_since(now_ns, period_ns, frame, node, slots), slots.slots[node], slots.cycle[node]
        if since < 0:
            continue
        slot = ((slots.counter[bus] - 1) * of_sync + since) % cycle
        is_back = state.slot[frame] >= 0 and (state.slot[frame] - slot) % cycle < min(of_sync, cycle // 4)
        if is_back or slots.under_way_ns[frame] > now_ns:
            continue
        if slots.under_way_ns[frame] > 0:  # lost
            give_back(frame, slots, state)
        row, first, last, least = slots.row[node], table.part[frame], table.part[frame] + table.parts[frame], 0.0
        for part in range(first, last):
            form, place = form_at(table.form, part), table.first[part]
            whole(sums_n[row, place:], unit_n, form, wanted[part])
            of_part = variance_n2[row, place:]
            least += threshold(of_part, noise_n[row], taxels, unit_n, slots.quiet[node], form)
        if offer(frame, first, last, wanted, least, slot, cycle, slots.keep_max[node], table.form, state):
            slots.under_way_ns[frame] = now_ns + LOST_NS
            chosen[count] = frame
            count += 1
    slots.done_ns[:] = now_ns
    return count


@njit(cache=True, nogil=True)
def give_back(frame: int, slots: Slots, state: State) -> None:
    """Take note of a frame that was not sent: receivers lack its words, so all sums are set."""
    slots.under_way_ns[frame] = 0
    state.unset[frame] = 0
