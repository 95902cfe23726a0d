"""The cyclic TPDOs of many nodes as arrays: one SYNC costs a few array operations, not hundreds of calls."""

import numpy as np
import numpy.typing as npt

from dbc import indices as od
from dbc.codec import encode
from dbc.contract import Contract, NodeContract
from dbc.frame import Frames, frames
from nodes.tpdo import LiveTpdo
from skin.sync_counter import SYNC_OVERFLOW


class Burst:
    """Plain TPDOs (`LiveTpdo.is_plain`), compiled from the present values of the nodes' dictionaries.

    Parameters
    ----------
    tpdos : list of (int, NodeContract, LiveTpdo)
        Place of the node in the segment, the node, and the PDO.
    """

    def __init__(self, contract: Contract, tpdos: list[tuple[int, NodeContract, LiveTpdo]]) -> None:
        self._packing = contract.packing
        self._node = np.array([place for place, _, _ in tpdos], np.intp)
        self._every = np.array([tpdo.every for *_, tpdo in tpdos], np.intp)
        self._start = np.array([tpdo.start for *_, tpdo in tpdos], np.intp)
        self._gather = np.full((len(tpdos), max((len(tpdo.mapped) - 1 for *_, tpdo in tpdos), default=0)), -1, np.intp)
        for row, (_, node, tpdo) in enumerate(tpdos):
            for column, (index, subindex, _) in enumerate(tpdo.mapped[1:]):
                block = node.block + od.split_block(index)[0]
                self._gather[row, column] = contract.phi.starts[block] + subindex - 1
        self._template = frames(len(tpdos))
        self._template["can_id"] = [tpdo.cob_id for *_, tpdo in tpdos]
        self._template["length"] = [tpdo.length for *_, tpdo in tpdos]
        self._template["port"] = [node.node_id for _, node, _ in tpdos]
        self._template["flags"] = [node.flags for _, node, _ in tpdos]
        self._syncs = 0

    def frames(self, counter: int, sums: npt.NDArray[np.int32], operational: npt.NDArray[np.bool_]) -> Frames:
        """Return the frames that answer SYNC `counter` (0: SYNC without counter), in node order.

        Parameters
        ----------
        sums : array of int32, shape (m,)
        operational : array of bool, shape (nodes,)
        """
        self._syncs += 1
        # `nodes.tpdo.is_turn` for all rows at once.
        turn = np.where((self._start > 0) & (counter > 0), (counter - self._start) % SYNC_OVERFLOW, self._syncs)
        due = operational[self._node] & (turn % self._every == 0)
        burst: Frames = self._template[due]
        payloads = encode(counter, sums, self._gather[due], self._packing)
        burst["data"][:, : payloads.shape[1]] = payloads
        return burst
