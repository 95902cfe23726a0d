"""Window identity: which frames of an earlier cycle may still come after a SYNC.

A frame belongs to the SYNC before it on the bus, because a node gives up what has not gone within 1007h. A stack that
runs in a timer of 1 ms gives up late: after the next SYNC, if the window ends less than the timer's period before. So a
frame that did not come in a cycle may come in the next. There it would pass for the answer to the new SYNC.
"""

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract
from dbc.dictionary import window_s


class Outstanding:
    """Frames that were asked for on a bus and have not come, by row of `Contract.table`."""

    def __init__(self, contract: Contract) -> None:
        table = contract.table
        self._node = table.node
        self._window_ns = round(window_s(contract.layout) * 1e9)
        self._of_bus = [np.flatnonzero(table.bus == bus) for bus in range(len(contract.layout.bus))]
        self._count = np.zeros(len(table.cob_id), np.intp)
        self._asked_ns = [0] * len(contract.layout.bus)
        #: Nodes that have sent nothing since they were last not proven.
        self._silent = np.ones(len(contract.nodes), np.bool_)

    def ask(self, bus: int, time_ns: int) -> npt.NDArray[np.intp]:
        """Take note of a SYNC on a bus; return the rows whose frame may be the answer to an earlier SYNC.

        Parameters
        ----------
        time_ns : int
            End of the SYNC, 0 if unknown.
        """
        rows = self._of_bus[bus]
        left = rows[self._count[rows] > 0]
        last_ns, self._asked_ns[bus] = self._asked_ns[bus], time_ns
        if not (time_ns and last_ns and time_ns - last_ns < self._window_ns):
            self._count[rows] = 0  # after the window the nodes have given up; see the module for the next cycle
        self._count[rows] += 1
        return left

    def came(self, row: npt.NDArray[np.intp]) -> None:
        """Take note of frames."""
        self._silent[self._node[row]] = False
        np.subtract.at(self._count, row, 1)
        self._count[row] = np.maximum(self._count[row], 0)

    def doubt(self, node: npt.NDArray[np.intp]) -> None:
        """Take note that nodes are not proven now."""
        self._silent[node] = True

    def prove(self, node: npt.NDArray[np.intp]) -> None:
        """Expect nothing of nodes that are proven and about to start: they have sent nothing since they were not."""
        fresh = np.zeros(len(self._silent), np.bool_)
        fresh[node] = self._silent[node]
        self._count[fresh[self._node]] = 0
