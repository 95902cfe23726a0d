"""Which nodes a gateway has proven, as far as the frames of a log tell.

A log may begin after the proofs, so at its beginning every node counts as proven. A node that boots, or is commanded
out of OPERATIONAL, is not. The gateway starts a node right after its proof, so the start tells of the proof; of nodes
that start by themselves, the heartbeat.
"""

from collections.abc import Collection, Iterator
from typing import Final, NamedTuple

import numpy as np

from dbc.canopen import HEARTBEAT_BASE, HEARTBEAT_BYTES, HIGHEST_NODE_ID, NMT_BYTES, NMT_COB_ID, NmtCommand, NmtState
from dbc.frame import ERROR, EXTENDED, REMOTE, Frames

#: Commands after which a gateway uses no sums of a node.
_ENDS: Final = {NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL}


class Change(NamedTuple):
    """A node is proven from the frame at a place on, or not."""

    place: int
    node_id: int
    is_proven: bool


class InferredProofs:
    """Follows the nodes of one bus; `nodes` are their node-IDs."""

    def __init__(self, nodes: Collection[int]) -> None:
        self._nodes = nodes
        self._doubted: set[int] = set()

    def changes(self, seen: Frames) -> Iterator[Change]:
        """Yield the changes that the next frames tell, in bus order."""
        can_id = seen["can_id"]
        is_told = (can_id == NMT_COB_ID) | (can_id & ~np.uint32(HIGHEST_NODE_ID) == HEARTBEAT_BASE)
        is_told &= seen["flags"] & (EXTENDED | REMOTE | ERROR) == 0
        for place in np.flatnonzero(is_told).tolist():
            data = seen["data"][place, : seen["length"][place]].tobytes()
            if can_id[place] == NMT_COB_ID:
                changed = self._commanded(data)
            else:
                changed = self._heard(int(can_id[place]) & HIGHEST_NODE_ID, data)
            for node_id, is_proven in changed:
                yield Change(place, node_id, is_proven)

    def _commanded(self, data: bytes) -> list[tuple[int, bool]]:
        if len(data) != NMT_BYTES:
            return []
        if data[0] == NmtCommand.START:
            follow = self._proven
        elif data[0] in _ENDS:
            follow = self._doubt
        else:
            return []
        return [change for node in (self._nodes if data[1] == 0 else [data[1]]) for change in follow(node)]

    def _heard(self, node_id: int, data: bytes) -> list[tuple[int, bool]]:
        if len(data) != HEARTBEAT_BYTES:
            return []
        state = data[0] & 0x7F
        if state == NmtState.INITIALISING:
            return self._doubt(node_id)
        return self._proven(node_id) if state == NmtState.OPERATIONAL else []

    def _doubt(self, node_id: int) -> list[tuple[int, bool]]:
        if node_id not in self._nodes or node_id in self._doubted:
            return []
        self._doubted.add(node_id)
        return [(node_id, False)]

    def _proven(self, node_id: int) -> list[tuple[int, bool]]:
        if node_id not in self._doubted:
            return []
        self._doubted.remove(node_id)
        return [(node_id, True)]
