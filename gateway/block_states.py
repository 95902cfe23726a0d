"""How the blocks of an adaptive skin stand, and their sums in the order of Φ."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.messages import BlockState
from dbc.adaptive import GROUP_SUMS, NO_CHECK, SendingRule
from gateway.adaptive_state import NEVER_NS, BusSums, Flags, Integers
from shell.compiled import borrowed, njit
from skin.walsh import grouped_rows

#: Time for which a block is fresh after a frame that counted.
FRESH_NS: Final = 100_000_000
#: Longest wait of a refresh for a full bus: after 500 ms it has the highest urgency.
OVERLOAD_NS: Final = 500_000_000
#: Time from the newest coarse frame of a group that is not zero until the group is overdue. Coarse and fine refreshes
#: take turns, so that coarse ones are two refresh times apart.
OVERDUE_NS: Final = 2 * SendingRule().refresh_max * 1_000_000 + OVERLOAD_NS

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
    unknown, doubtful : arrays of uint8, shape (blocks,)
        Groups, a bit each: of which nothing is held; that may have changed since what is held was sent.
    places : array of int64, shape (sums,)
        Hadamard row of each sum in the order of the frames.
    """

    sums: npt.NDArray[np.int32]
    known: npt.NDArray[np.uint8]
    valid: npt.NDArray[np.uint8]
    states: npt.NDArray[np.uint8]
    since_ns: Integers
    unknown: npt.NDArray[np.uint8]
    doubtful: npt.NDArray[np.uint8]
    places: Integers


def new_states(blocks: int, groups: int, now_ns: int) -> BlockStates:
    """Return the state of blocks of which nothing is known."""
    sums = GROUP_SUMS * groups
    return BlockStates(
        sums=np.zeros((blocks, sums), np.int32),
        known=np.zeros((blocks, sums), np.uint8),
        valid=np.zeros(blocks, np.uint8),
        states=np.full(blocks, BlockState.DEAD, np.uint8),
        since_ns=np.full(blocks, now_ns, np.int64),
        unknown=np.full(blocks, (1 << groups) - 1, np.uint8),
        doubtful=np.zeros(blocks, np.uint8),
        places=grouped_rows(sums).ravel().astype(np.int64),
    )


@njit(cache=True, nogil=True)
def judge(  # noqa: PLR0917  compiled functions take no keywords
    now_ns: int, newton_per_count: float, is_proven: Flags, sums: BusSums, has_changed: Flags, shown: BlockStates
) -> None:
    """Bring what is shown up to date.

    Parameters
    ----------
    is_proven : array of bool, shape (blocks,)
    sums : BusSums
        Of all blocks.
    has_changed : array of bool, shape (blocks, groups)
        Groups whose sums are not yet shown; cleared.
    """
    sums, shown = borrowed(sums), borrowed(shown)
    every_group = (1 << has_changed.shape[1]) - 1
    for block in range(is_proven.size):
        unknown, doubtful, newest_ns = 0, 0, NEVER_NS
        for group in range(has_changed.shape[1]):
            is_held = sums.check[block, group] != NO_CHECK
            if has_changed[block, group]:
                has_changed[block, group] = False
                _show(block, group, newton_per_count, sums, shown)
            if not is_held:
                unknown |= 1 << group
            newest_ns = max(newest_ns, sums.seen_ns[block, group])
            if sums.is_lost[block, group] or (is_held and _is_overdue(block, group, now_ns, sums)):
                doubtful |= 1 << group
        state, since_ns = _FRESH, newest_ns
        if not is_proven[block] or unknown == every_group:
            state, since_ns = _DEAD, now_ns
        elif doubtful:
            state, since_ns = _STALE, now_ns
        elif now_ns - newest_ns > FRESH_NS:
            state, since_ns = _QUIET, newest_ns + FRESH_NS
        if state != shown.states[block]:
            shown.states[block], shown.since_ns[block] = state, since_ns
        shown.unknown[block], shown.doubtful[block] = unknown, doubtful
        shown.valid[block] = state >= _QUIET and not unknown


@njit(cache=True, nogil=True)
def _show(block: int, group: int, newton_per_count: float, sums: BusSums, shown: BlockStates) -> None:
    is_held = sums.check[block, group] != NO_CHECK
    for place in range(GROUP_SUMS * group, GROUP_SUMS * (group + 1)):
        row = shown.places[place]
        shown.sums[block, row] = round(sums.value_n[block, place] / newton_per_count) if is_held else 0
        shown.known[block, row] = is_held


@njit(cache=True, nogil=True)
def _is_overdue(block: int, group: int, now_ns: int, sums: BusSums) -> bool:
    """Tell whether a refresh should have come; a group at zero is not refreshed for ever."""
    if now_ns - sums.coarse_ns[block, group] <= OVERDUE_NS:
        return False
    mine = slice(GROUP_SUMS * group, GROUP_SUMS * (group + 1))
    return bool(sums.value_n[block, mine].any() and sums.coarse_n[block, mine].any())
