"""The TPDOs that answer a SYNC, compiled from the nodes' dictionaries into arrays.

An SDO write to a PDO record changes what is sent: the burst is compiled anew from the dictionaries.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.codec import encode
from dbc.contract import SYNC_OVERFLOW
from dbc.frame import Frames, frames
from dbc.indices import OD_SUMS, OD_TPDO_COMMUNICATION, OD_TPDO_MAPPING
from nodes.node import NmtState, SkinNode

#: Bit 31 of a COB-ID object: the PDO does not exist (CiA 301, 7.5.2.37).
PDO_INVALID: Final = 0x8000_0000
LAST_SYNCHRONOUS_TYPE: Final = 240


@dataclass(frozen=True)
class _Row:
    node: int
    cob_id: int
    every: int
    start: int
    gather: list[int]


class Burst:
    """All synchronous TPDOs of some nodes.

    Parameters
    ----------
    nodes : list of SkinNode
    starts : array of int
        Where each block's sums start (`Sbhe.starts`).
    """

    def __init__(self, nodes: list[SkinNode], starts: npt.NDArray[np.intp]) -> None:
        rows = [
            row for number, node in enumerate(nodes) for row in _rows(number, node, int(starts[node.contract.block]))
        ]
        self._nodes = nodes
        self._node = np.array([row.node for row in rows], np.intp)
        self._every = np.array([row.every for row in rows], np.intp)
        self._start = np.array([row.start for row in rows], np.intp)
        self._gather = np.full((len(rows), 4), -1, np.intp)
        for number, row in enumerate(rows):
            self._gather[number, : len(row.gather)] = row.gather
        self._template = frames(len(rows))
        self._template["can_id"] = [row.cob_id for row in rows]
        self._template["length"] = [2 * len(row.gather) for row in rows]
        self._template["port"] = [nodes[row.node].contract.node_id for row in rows]
        self._syncs = 0

    def frames(self, counter: int, sums: npt.NDArray[np.int16]) -> Frames:
        """Return the frames that SYNC `counter` (0: without counter) calls for, in node order."""
        self._syncs += 1
        operational = np.array([node.state is NmtState.OPERATIONAL for node in self._nodes], np.bool_)
        # With a SYNC start value the counter decides, so that a missed SYNC does not shift the turn.
        count = np.where((self._start > 0) & (counter > 0), (counter - self._start) % SYNC_OVERFLOW, self._syncs)
        due = operational[self._node] & (count % self._every == 0)
        burst: Frames = self._template[due]
        burst["data"][:, :8] = encode(sums, self._gather[due])
        return burst


def _rows(number: int, node: SkinNode, first_sum: int) -> list[_Row]:
    rows = []
    for tpdo in node.contract.tpdos:
        communication = OD_TPDO_COMMUNICATION + tpdo.number - 1
        mapping = OD_TPDO_MAPPING + tpdo.number - 1
        cob_id = node.value(communication, 1)
        every = node.value(communication, 2)
        if cob_id & PDO_INVALID or not 1 <= every <= LAST_SYNCHRONOUS_TYPE:
            continue
        mapped = [node.value(mapping, place) for place in range(1, node.value(mapping, 0) + 1)]
        places = [entry >> 8 & 0xFF for entry in mapped if entry >> 16 == OD_SUMS]
        gather = [first_sum + place - 1 for place in places if 1 <= place <= node.contract.sums][:4]
        rows.append(_Row(number, cob_id & 0x7FF, every, node.value(communication, 6), gather))
    return rows
