"""How the blocks of a stepped skin stand, and their sums in the order of Φ."""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.messages import BlockState
from dbc.contract import Contract, PartTable
from dbc.frame_fields import Flags, Integers
from dbc.steps import LATE_SLOTS, SET_SUMS, form_at
from gateway.stepped_state import NEVER_NS, PartSums, forget
from shell.compiled import borrowed, njit
from skin.walsh import grouped_rows

#: Time for which a block is fresh after a frame that counted.
FRESH_NS: Final = 100_000_000

#: Plain numbers for compiled code.
_DEAD, _STALE, _QUIET, _FRESH = (
    int(each) for each in (BlockState.DEAD, BlockState.STALE, BlockState.QUIET, BlockState.FRESH)
)


class BlockStates(NamedTuple):
    """What a measurement says of the blocks; see `canskin.messages.Measurement`.

    Attributes
    ----------
    sums : array of int32, shape (blocks, sums)
        In the order of Φ: of Hadamard rows.
    known : array of uint8, shape (blocks, sums)
    valid, states : arrays of uint8, shape (blocks,)
    since_ns : array of int64, shape (blocks,)
    is_wanted : array of bool, shape (blocks,)
        All sums have to come again: some are missing, or came late, and none came since.
    places : array of int64, shape (sums,)
        Hadamard row of each sum in the order of the frames.
    """

    sums: npt.NDArray[np.int32]
    known: npt.NDArray[np.uint8]
    valid: npt.NDArray[np.uint8]
    states: npt.NDArray[np.uint8]
    since_ns: Integers
    is_wanted: Flags
    places: Integers


def new_states(contract: Contract, now_ns: int) -> BlockStates:
    """Return the state of blocks of which nothing is known."""
    blocks, sums = contract.phi.blocks, contract.phi.block_size
    return BlockStates(
        sums=np.zeros((blocks, sums), np.int32),
        known=np.zeros((blocks, sums), np.uint8),
        valid=np.zeros(blocks, np.uint8),
        states=np.full(blocks, BlockState.DEAD, np.uint8),
        since_ns=np.full(blocks, now_ns, np.int64),
        is_wanted=np.ones(blocks, np.bool_),
        places=grouped_rows(sums).ravel().astype(np.int64),
    )


@njit(cache=True, nogil=True)
def judge(now_ns: int, counts_per_unit: float, known: Any, shown: BlockStates) -> None:
    """Find parts that are silent for too long, and bring what is shown up to date.

    Parameters
    ----------
    counts_per_unit : float
        Of the sums that are shown, for each unit of the frames.
    known : shell.compiled.Held
        As for `gateway.stepped_state.take_all`.
    """
    (is_proven, slots, table, state), shown = borrowed(known.value), borrowed(shown)
    part, parts = 0, table.block.size
    # Without SYNC boards have slots for two periods: from then on they say nothing, whatever happens.
    unslotted_ns = (2 * slots.per_sync + LATE_SLOTS) * slots.slot_ns
    for block in range(is_proven.size):
        newest_ns, is_known, is_wanted = NEVER_NS, False, False
        since_ns = now_ns - state.sync_ns[slots.bus[block]]
        is_doubtful, since = since_ns > unslotted_ns, since_ns // slots.slot_ns
        slot = state.sync_slot[slots.bus[block]] + min(since, 2 * slots.per_sync - 1)
        # Words that were due when this SYNC moved the numbers on have come, or are late, after that.
        grace = LATE_SLOTS + (slots.jump if since <= LATE_SLOTS else 0)
        while part < parts and table.block[part] == block:
            if state.newest_ns[part] != NEVER_NS and now_ns - state.newest_ns[part] > slots.silence * slots.slot_ns:
                forget(part, table, state)
            age = (slot - state.slot[part]) % slots.cycle
            if state.wait[part] + grace < age <= slots.cycle - slots.jump:  # else the newest word is ahead
                state.is_late[part] = True
            newest_ns = max(newest_ns, state.newest_ns[part])
            is_known |= state.unknown[part] != (1 << form_at(table.form, part).groups) - 1
            is_late, quiet_ns = state.is_late[part], now_ns - state.newest_ns[part]
            is_doubtful |= state.missing[part] != 0 or is_late
            is_wanted |= state.missing[part] != 0 or (is_late and quiet_ns > LATE_SLOTS * slots.slot_ns)
            if state.has_changed[part]:
                state.has_changed[part] = False
                _show(part, counts_per_unit, table, state, shown)
            part += 1
        become, since_ns = _FRESH, newest_ns
        if not is_proven[block] or not is_known:
            become, since_ns = _DEAD, now_ns
        elif is_doubtful:
            become, since_ns = _STALE, now_ns
        elif now_ns - newest_ns > FRESH_NS:
            become, since_ns = _QUIET, newest_ns + FRESH_NS
        if become != shown.states[block]:
            shown.states[block], shown.since_ns[block] = become, since_ns
        shown.is_wanted[block], shown.valid[block] = is_wanted, become >= _QUIET


@njit(cache=True, nogil=True)
def _show(part: int, counts_per_unit: float, table: PartTable, state: PartSums, shown: BlockStates) -> None:
    block = table.block[part]
    for place in range(form_at(table.form, part).sums):
        row = shown.places[table.first[part] + place]
        is_known = not state.unknown[part] >> place // SET_SUMS & 1
        shown.known[block, row] = is_known
        shown.sums[block, row] = round(state.known[part, place] * counts_per_unit) if is_known else 0
