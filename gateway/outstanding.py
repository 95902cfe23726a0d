"""Window identity: which frames of an earlier cycle may still come after a SYNC.

A frame belongs to the SYNC before it on the bus, because a node gives up what has not gone within 1007h. A stack that
runs in a timer of 1 ms gives up late: after the next SYNC, if the window ends less than the timer's period before. So a
frame that did not come in a cycle may come in the next. There it would pass for the answer to the new SYNC.

Where nodes have two states, a SYNC asks for the frames of one. A node that missed the switch sends the others.
So after SYNCs that asked for other frames, the first cycle is doubtful. Where a node strayed (it sent meanwhile), the
second cycle is doubtful, too.
"""

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract


class Outstanding:
    """Frames that were asked for on a bus and have not come, by row of `Contract.table`."""

    def __init__(self, contract: Contract) -> None:
        table, buses = contract.table, len(contract.layout.bus)
        self._node, self._bus = table.node, table.bus
        self._of_bus = [np.flatnonzero(table.bus == bus) for bus in range(buses)]
        self._count = np.zeros(len(table.cob_id), np.intp)
        #: When the newest SYNC ended on each bus, and its window.
        self._asked_ns, self._window_ns = [0] * buses, [0] * buses
        #: Whether the newest SYNC of a bus asked for none of these frames.
        self._rests = np.zeros(buses, np.bool_)
        #: Nodes that sent these frames all the same, by row; and rows that are doubtful at the next SYNC for that.
        self._strayed, self._doubtful = (np.zeros(len(table.cob_id), np.bool_) for _ in range(2))
        #: Nodes that have sent nothing since they were last not proven.
        self._silent = np.ones(len(contract.nodes), np.bool_)

    def ask(self, bus: int, time_ns: int, window_ns: int) -> npt.NDArray[np.intp]:
        """Take note of a SYNC on a bus; return the rows whose frame may be the answer to an earlier SYNC.

        Parameters
        ----------
        time_ns : int
            End of the SYNC, 0 if unknown.
        window_ns : int
            Within this time after the SYNC the nodes send (1007h).
        """
        rows = self._of_bus[bus]
        is_first = bool(self._rests[bus])
        left = rows if is_first else rows[(self._count[rows] > 0) | self._doubtful[rows]]
        self._doubtful[rows] = is_first & self._strayed[rows]
        self._strayed[rows] = False
        self._rests[bus] = False
        if self._note(bus, time_ns, window_ns):
            self._count[rows] = 0  # after the window the nodes have given up; see the module for the next cycle
        self._count[rows] += 1
        return left

    def rest(self, bus: int, time_ns: int, window_ns: int) -> None:
        """Take note of a SYNC that asks for none of these frames; parameters as for `ask`."""
        self._note(bus, time_ns, window_ns)
        rows = self._of_bus[bus]
        self._rests[bus] = True
        self._count[rows] = 0

    def _note(self, bus: int, time_ns: int, window_ns: int) -> bool:
        """Keep the time of a SYNC; tell whether the window of the SYNC before has passed."""
        last_ns, self._asked_ns[bus] = self._asked_ns[bus], time_ns
        last_window_ns, self._window_ns[bus] = self._window_ns[bus], window_ns
        return not (time_ns and last_ns and time_ns - last_ns < last_window_ns)

    def came(self, row: npt.NDArray[np.intp]) -> None:
        """Take note of frames."""
        self._silent[self._node[row]] = False
        resting = row[self._rests[self._bus[row]]]
        if len(resting):
            self._strayed |= np.isin(self._node, self._node[resting])
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
