"""What the gateway knows of adaptive nodes: the newest value of every sum, and how old it is.

A fine frame counts only for the coarse frame that it refines: its check must be that of the coarse frame that is
held. After frames were lost, no fine frame counts until the next coarse one of its group, so that none is misread. On
CAN FD every frame has the coarse codes of its groups: it needs no other frame, and whatever comes ends a loss. A
loss that the receiver does not know of can have a fine frame misread where the lost coarse frame and the one that is
held have the same check: two frames that differ in one byte never have, of others one pair in 255 or 256.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.adaptive import (
    GROUP_SUMS,
    LEVELS,
    NO_CHECK,
    Companding,
    carried,
    decode_cob_id,
    hold,
    payload_bytes,
)
from dbc.canopen import SYNC_COB_ID
from dbc.frame import CAN_ID_AT, DATA_AT, ECHO, ERROR, EXTENDED, FD, FLAGS_AT, LENGTH_AT, REMOTE, TIME_AT
from dbc.frame_fields import field
from shell.compiled import borrowed, njit
from skin.sending import IDENTIFIERS

#: A time before all frames.
NEVER_NS: Final = -(1 << 62)

Integers = npt.NDArray[np.int64]
Numbers = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class BusSums(NamedTuple):
    """The sums of the nodes of one bus.

    Attributes
    ----------
    value_n, coarse_n : arrays of float64, shape (nodes, sums)
        Newest value of every sum, and that of the newest coarse frame, newtons.
    check : array of int64, shape (nodes, groups)
        Check of the coarse frame that is held, or `NO_CHECK`.
    is_lost : array of bool, shape (nodes, groups)
        A frame may have been lost since the newest coarse frame: no fine frame counts.
    coarse_ns, seen_ns : arrays of int64, shape (nodes, groups)
        When the newest coarse frame and the newest frame of any kind that counted ended.
    place_of : array of int64, shape (IDENTIFIERS,)
        Which node has a column of the identifiers (`dbc.adaptive.column_of`), -1 for none.
    counts : array of int64, shape (6,)
        Frames used, fine frames without their coarse frame, frames of a wrong length, frames of nodes that are not
        proven, all other frames, and those of these that are SYNCs.
    """

    value_n: Numbers
    coarse_n: Numbers
    check: Integers
    is_lost: Flags
    coarse_ns: Integers
    seen_ns: Integers
    place_of: Integers
    counts: Integers

    def of(self, nodes: slice, columns: Sequence[int]) -> "BusSums":
        """Return a view of some nodes, with counts of its own; `columns` are those of their identifiers."""
        return BusSums(
            value_n=self.value_n[nodes],
            coarse_n=self.coarse_n[nodes],
            check=self.check[nodes],
            is_lost=self.is_lost[nodes],
            coarse_ns=self.coarse_ns[nodes],
            seen_ns=self.seen_ns[nodes],
            place_of=_place_of(columns),
            counts=np.zeros_like(self.counts),
        )


#: Places of `BusSums.counts`.
USED, UNREFINED, MALFORMED, UNPROVEN, FOREIGN, FOREIGN_SYNCS = range(6)


def new_sums(nodes: int, groups: int) -> BusSums:
    """Return the state of a gateway that has received nothing of nodes with `groups` groups and the first columns."""
    return BusSums(
        value_n=np.zeros((nodes, GROUP_SUMS * groups)),
        coarse_n=np.zeros((nodes, GROUP_SUMS * groups)),
        check=np.full((nodes, groups), NO_CHECK, np.int64),
        is_lost=np.zeros((nodes, groups), np.bool_),
        coarse_ns=np.full((nodes, groups), NEVER_NS, np.int64),
        seen_ns=np.full((nodes, groups), NEVER_NS, np.int64),
        place_of=_place_of(range(nodes)),
        counts=np.zeros(6, np.int64),
    )


def _place_of(columns: Sequence[int]) -> Integers:
    found = np.full(IDENTIFIERS, -1, np.int64)
    for place, column in enumerate(columns[:IDENTIFIERS]):
        found[column] = place
    return found


@njit(cache=True, nogil=True)
def take_all(  # noqa: PLR0917  compiled functions take no keywords
    rows: npt.NDArray[np.uint8],
    has_gap: bool,
    law: Companding,
    is_proven: Flags,
    sums: BusSums,
    has_changed: Flags,
    is_fd: bool = False,
) -> int:
    """Use the frames of a bus, in bus order; return when the newest that was used ended, or `NEVER_NS`.

    A fine frame that does not fit tells of a lost coarse frame: its group is lost until the next.

    Parameters
    ----------
    rows : array of uint8, shape (frames, bytes of a FRAME)
    has_gap : bool
        Frames were lost just before or among these: no fine frame among them counts, and every group is lost until a
        later coarse frame.
    is_proven : array of bool, shape (nodes,)
        Nodes whose frames may be used.
    has_changed : array of bool, shape (nodes, groups)
        Set for groups of which a frame was used.
    is_fd : bool
        The bus carries CAN FD.
    """
    (rows,), sums = borrowed((rows,)), borrowed(sums)
    newest_ns: int = NEVER_NS
    of_node = sums.check.shape[1]
    together = carried(of_node, is_fd)
    if has_gap:
        sums.is_lost[:] = True
    for place in range(rows.shape[0]):
        row = rows[place]
        if row[FLAGS_AT] & (ERROR | ECHO):
            continue
        can_id = field(row, CAN_ID_AT, 4)
        kind, group, column = decode_cob_id(can_id, of_node, is_fd)
        node = sums.place_of[column]
        is_strange = row[FLAGS_AT] & (EXTENDED | REMOTE) != 0 or (row[FLAGS_AT] & FD != 0) != is_fd
        if is_strange or kind < 0 or node < 0:
            sums.counts[FOREIGN] += 1
            sums.counts[FOREIGN_SYNCS] += can_id == SYNC_COB_ID and not row[FLAGS_AT] & (EXTENDED | REMOTE)
            continue
        if not is_proven[node]:
            sums.counts[UNPROVEN] += 1
            continue
        ended_ns = field(row, TIME_AT, 8)
        is_fine, is_lost = kind >= LEVELS, has_gap
        groups = slice(group, group + together)
        is_unsure = is_fine and not is_fd and sums.is_lost[node, group]
        if row[LENGTH_AT] != payload_bytes(is_fine, is_fd, of_node):
            sums.counts[MALFORMED] += 1
        elif is_unsure or not hold(
            row[DATA_AT:], group, is_fine, is_fd, law, sums.value_n[node], sums.coarse_n[node], sums.check[node]
        ):
            sums.counts[MALFORMED if is_fd else UNREFINED] += 1
            is_lost |= not is_fd
        else:
            if is_fd or not is_fine:
                sums.is_lost[node, groups] = False
                sums.coarse_ns[node, groups] = ended_ns
            sums.seen_ns[node, groups] = ended_ns
            sums.counts[USED] += 1
            has_changed[node, groups] = True
            newest_ns = max(newest_ns, int(ended_ns))
        sums.is_lost[node, groups] |= is_lost
    return newest_ns


def forget_node(node: int, sums: BusSums) -> None:
    """Hold nothing of a node any more."""
    sums.value_n[node] = sums.coarse_n[node] = 0
    sums.check[node], sums.is_lost[node] = NO_CHECK, False
    sums.coarse_ns[node] = sums.seen_ns[node] = NEVER_NS
