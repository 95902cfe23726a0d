"""What the gateway asks stepped nodes for besides proofs: all sums again (2030h), and their noise (2035h).

Few nodes of a bus are asked one by one. Where sums of many are missing, as after a loss on the bus, all nodes are
started again (`NmtMaster.restart`): NMT goes before all sums, where SDO on a full bus waits behind them. Pauses grow,
so that a gateway that cannot keep up does not ask for ever more frames.
"""

import struct
from collections.abc import Callable, Generator
from typing import Final

import numpy as np

from dbc import indices as od
from dbc.frame_fields import Flags
from gateway.nmt_master import NmtMaster
from gateway.sdo import Read, SdoDialogue, Transfer, Write

#: Pauses after requests for sums to the same node, in times that a node needs to tell all of them; the last pause
#: follows every further request.
PAUSES: Final = (1, 2, 4, 8)
#: Most nodes of a bus that are asked at the same time; where more have to be, all are started again.
MOST_ASKED: Final = 4
#: Time between two reads of a node's noise.
NOISE_PERIOD_S: Final = 10.0
#: Time until the next try when a node cannot be asked now; meanwhile the other nodes have their turn.
NOISE_RETRY_S: Final = 1.0

_Steps = Generator[Transfer, bytes, None]


class SumRequests:
    """The requests to the nodes of one bus. Nodes are named by their place on the bus.

    Parameters
    ----------
    master : NmtMaster
        Its SDO dialogues are used: one at a time with a node.
    take_noise : callable
        Called with a node and its noise, newtons.
    telling_s : float
        Time in which a node that was asked tells all its sums.
    sync_s : float
        Time from SYNC to SYNC: a node that is started may wait for the next.
    """

    def __init__(
        self, master: NmtMaster, take_noise: Callable[[int, float], None], telling_s: float, sync_s: float
    ) -> None:
        self._master = master
        self._take_noise = take_noise
        self._telling_s, self._start_s = telling_s, telling_s + sync_s
        self._ids = master.node_ids
        nodes = len(self._ids)
        self._is_used = np.zeros(nodes, np.bool_)
        self._noise_s = np.full(nodes, np.inf)
        self._next_s = np.full(nodes, -np.inf)
        self._tries = np.zeros(nodes, np.intp)
        self._open: list[tuple[int, SdoDialogue]] = []

    def proven(self, node: int, now_s: float) -> None:
        """Take note that a node has just been proven: its noise is asked for, and sums that its start did not bring."""
        self._is_used[node], self._noise_s[node] = True, now_s
        self._next_s[node] = self._master.nodes[self._ids[node]].commanded_s + self._start_s
        self._tries[node] = 0

    def lost(self, node: int) -> None:
        """Ask a node for nothing until it is proven again."""
        self._is_used[node], self._noise_s[node] = False, np.inf

    def again(self) -> None:
        """Begin the pauses of all nodes anew: the bus is back."""
        self._next_s[:], self._tries[:] = -np.inf, 0

    def tick(self, now_s: float, is_wanted: Flags) -> None:
        """Ask who has to be asked; call it each `TICK_S`.

        Parameters
        ----------
        is_wanted : array of bool, shape (nodes,)
            Nodes that have to send all sums again.
        """
        if self._master.is_quiet:
            np.maximum(self._next_s, now_s + self._start_s, out=self._next_s)
            return
        records = self._master.nodes
        self._open = [(node_id, each) for node_id, each in self._open if records[node_id].errand is each]
        is_due = now_s >= self._next_s
        self._tries[is_due & ~is_wanted] = 0
        due = np.flatnonzero(self._is_used & is_wanted & is_due)
        if len(due) > MOST_ASKED:
            self._master.restart(now_s)
            for node in due.tolist():
                self._pause(node, now_s)
            return
        for node in due[np.argsort(self._next_s[due], kind="stable")].tolist():
            if self._ask(node, _refresh(), now_s):
                self._pause(node, now_s)
        oldest = int(self._noise_s.argmin())
        if now_s >= self._noise_s[oldest]:
            is_asked = self._ask(oldest, self._noise(oldest), now_s)
            self._noise_s[oldest] = now_s + (NOISE_PERIOD_S if is_asked else NOISE_RETRY_S)

    def _pause(self, node: int, now_s: float) -> None:
        self._next_s[node] = now_s + PAUSES[self._tries[node]] * self._telling_s
        self._tries[node] = min(self._tries[node] + 1, len(PAUSES) - 1)

    def _ask(self, node: int, steps: _Steps, now_s: float) -> bool:
        if len(self._open) >= MOST_ASKED:
            return False
        dialogue = self._master.ask(self._ids[node], steps, now_s)
        if dialogue is not None:
            self._open.append((self._ids[node], dialogue))
        return dialogue is not None

    def _noise(self, node: int) -> _Steps:
        """Read a node's noise; a node without one (0) is not counted."""
        (noise_n,) = struct.unpack("<f", (yield Read(od.NODE_NOISE, 0, od.REAL32)))
        if 0 < noise_n < np.inf:
            self._take_noise(node, noise_n)


def _refresh() -> _Steps:
    """Ask a node to send all sums again."""
    yield Write(od.REFRESH, 0, b"\1")
