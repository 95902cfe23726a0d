"""What the gateway knows of adaptive nodes: the newest value of every sum, and how old it is.

A fine frame counts only for the coarse frame that it refines: its check must be that of the coarse frame that is
held. After frames were lost, no fine frame counts until the next coarse one of its group, so that none is misread. A
loss that the receiver does not know of can have a fine frame misread where the lost coarse frame and the one that is
held have the same check: two frames that differ in one byte never have, of others one pair in 255 or 256.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dbc.adaptive import (
    BLOCK_SUMS,
    FIRST_COB_ID,
    GROUP_SUMS,
    LEVELS,
    NODES,
    TPDOS,
    Companding,
    check_of,
    hold_coarse,
    unpack_fine,
)
from skin.walsh import GROUPS

#: No coarse frame of the group is held.
NO_CHECK: Final = -1
_NEVER_NS: Final = -(1 << 62)


class BusSums(NamedTuple):
    """The sums of the nodes of one bus.

    Attributes
    ----------
    value_n, coarse_n : arrays of float64, shape (nodes, BLOCK_SUMS)
        Newest value of every sum, and that of the newest coarse frame, newtons.
    check : array of int64, shape (nodes, GROUPS)
        Check of the coarse frame that is held, or `NO_CHECK`.
    coarse_ns, seen_ns : arrays of int64, shape (nodes, GROUPS)
        When the newest coarse frame and the newest frame of any kind that counted ended.
    counts : array of int64, shape (3,)
        Frames used, fine frames without their coarse frame, frames of a wrong length.
    """

    value_n: npt.NDArray[np.float64]
    coarse_n: npt.NDArray[np.float64]
    check: npt.NDArray[np.int64]
    coarse_ns: npt.NDArray[np.int64]
    seen_ns: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int64]


#: Places of `BusSums.counts`.
USED, UNREFINED, MALFORMED = range(3)


def new_sums(nodes: int) -> BusSums:
    """Return the state of a gateway that has received nothing."""
    return BusSums(
        value_n=np.zeros((nodes, BLOCK_SUMS)),
        coarse_n=np.zeros((nodes, BLOCK_SUMS)),
        check=np.full((nodes, GROUPS), NO_CHECK, np.int64),
        coarse_ns=np.full((nodes, GROUPS), _NEVER_NS, np.int64),
        seen_ns=np.full((nodes, GROUPS), _NEVER_NS, np.int64),
        counts=np.zeros(3, np.int64),
    )


@njit(cache=True, nogil=True)
def take(  # noqa: PLR0917  compiled functions take no keywords
    can_id: int, length: int, payload: Any, ended_ns: int, law: Companding, sums: BusSums
) -> bool:
    """Use one frame; False where its identifier is not that of adaptive sums."""
    index, node = (can_id - FIRST_COB_ID) // NODES, (can_id - FIRST_COB_ID) % NODES
    if can_id < FIRST_COB_ID or index >= TPDOS or node >= sums.check.shape[0]:
        return False
    if length != GROUP_SUMS:
        sums.counts[MALFORMED] += 1
        return True
    group = index % GROUPS
    first = GROUP_SUMS * group
    if index >= GROUPS * LEVELS:
        if sums.check[node, group] != int(payload[GROUP_SUMS - 1]):
            sums.counts[UNREFINED] += 1
            return True
        mine = slice(first, first + GROUP_SUMS)
        unpack_fine(payload, sums.coarse_n[node, mine], law, sums.value_n[node, mine])
    else:
        is_held = sums.check[node, group] != NO_CHECK
        hold_coarse(payload, first, is_held, law, sums.value_n[node], sums.coarse_n[node])
        sums.check[node, group] = check_of(payload)
        sums.coarse_ns[node, group] = ended_ns
    sums.seen_ns[node, group] = ended_ns
    sums.counts[USED] += 1
    return True


def forget(sums: BusSums) -> None:
    """Take note that frames of this bus were lost: no fine frame counts until the next coarse one of its group."""
    sums.check[:] = NO_CHECK
