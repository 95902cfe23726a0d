"""The cyclic TPDOs of some nodes as arrays, so that one SYNC costs a few array operations and not hundreds of calls."""

import numpy as np
import numpy.typing as npt

from dbc.codec import encode
from dbc.contract import SYNC_OVERFLOW
from dbc.frame import Frames, frames
from nodes.tpdo import Tpdo


class Burst:
    """Plain TPDOs (`Tpdo.is_plain`), compiled from what the nodes' dictionaries say now.

    Parameters
    ----------
    tpdos : list of (int, int, int, Tpdo)
        Place of the node in the segment, its node-ID, its first sum, and the PDO.
    """

    def __init__(self, tpdos: list[tuple[int, int, int, Tpdo]]) -> None:
        self._node = np.array([place for place, _, _, _ in tpdos], np.intp)
        self._every = np.array([tpdo.every for *_, tpdo in tpdos], np.intp)
        self._start = np.array([tpdo.start for *_, tpdo in tpdos], np.intp)
        self._gather = np.full((len(tpdos), 4), -1, np.intp)
        for row, (_, _, first_sum, tpdo) in enumerate(tpdos):
            self._gather[row, : len(tpdo.mapped)] = [first_sum + subindex - 1 for _, subindex in tpdo.mapped]
        self._template = frames(len(tpdos))
        self._template["can_id"] = [tpdo.cob_id for *_, tpdo in tpdos]
        self._template["length"] = [tpdo.length for *_, tpdo in tpdos]
        self._template["port"] = [node_id for _, node_id, _, _ in tpdos]
        self._syncs = 0

    def frames(self, counter: int, sums: npt.NDArray[np.int16], operational: npt.NDArray[np.bool_]) -> Frames:
        """Return the frames that SYNC `counter` (0: without counter) calls for, in node order.

        Parameters
        ----------
        sums : array of int16, shape (m,)
        operational : array of bool, shape (nodes,)
        """
        self._syncs += 1
        # As `nodes.tpdo.is_turn`, for all rows at once.
        turn = np.where((self._start > 0) & (counter > 0), (counter - self._start) % SYNC_OVERFLOW, self._syncs)
        due = operational[self._node] & (turn % self._every == 0)
        burst: Frames = self._template[due]
        burst["data"][:, :8] = encode(sums, self._gather[due])
        return burst
