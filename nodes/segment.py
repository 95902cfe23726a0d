"""All virtual nodes of one bus behind one link: what comes in, and what answers."""

from collections.abc import Collection

import numpy as np
from bus.link import Link

from dbc.contract import NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID, Contract
from dbc.dictionary import dictionary
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from nodes.burst import Burst
from nodes.network import SegmentNetwork
from nodes.node import SkinNode
from nodes.sampler import Sampler


class Segment:
    """The nodes of one bus.

    Parameters
    ----------
    made : Contract
    bus : int
        Number of the bus in the layout.
    node_ids : collection of int
        Which of its nodes live here.
    """

    def __init__(self, made: Contract, bus: int, node_ids: Collection[int], link: Link, sampler: Sampler) -> None:
        self.link = link
        self.frames_sent = 0
        self.frames_dropped = 0
        self.syncs_seen = 0
        #: Frames that made the CANopen library raise; they are dropped.
        self.frames_rejected = 0
        self._sampler = sampler
        self._starts = made.phi.starts
        self._network = SegmentNetwork(link)
        self.nodes = [
            SkinNode(node, dictionary(made, node), self._network)
            for node in made.on_bus(bus)
            if node.node_id in node_ids
        ]
        self._by_id = {node.contract.node_id: node for node in self.nodes}
        self._burst = Burst(self.nodes, self._starts)

    def boot(self, now_s: float) -> None:
        """Power all nodes up."""
        for node in self.nodes:
            node.boot(now_s)

    def beat(self, now_s: float) -> None:
        """Send the heartbeats that are due."""
        for node in self.nodes:
            node.beat(now_s)

    def receive(self, now_s: float) -> None:
        """Handle every frame that waits on the link."""
        arrived = self.link.receive()
        if not len(arrived):
            return
        ours = arrived[arrived["flags"] & (ERROR | ECHO | EXTENDED | REMOTE) == 0]
        known = (ours["can_id"] == SYNC_COB_ID) | (ours["can_id"] == NMT_COB_ID)
        known |= (ours["can_id"] > SDO_REQUEST_BASE) & (ours["can_id"] <= SDO_REQUEST_BASE + 127)
        for frame in ours[known]:
            self._handle(frame, now_s)

    def _handle(self, frame: np.void, now_s: float) -> None:
        can_id, length = int(frame["can_id"]), int(frame["length"])
        data = frame["data"][:length].tobytes()
        if can_id == SYNC_COB_ID:
            self._sync(data[0] if length else 0, int(frame["time_ns"]))
        elif can_id == NMT_COB_ID:
            self._nmt(data, now_s)
        elif length == 8:
            self._sdo(can_id, data, frame)

    def _sync(self, counter: int, time_ns: int) -> None:
        self.syncs_seen += 1
        if any(node.pdo_changed for node in self.nodes):
            self._compile()
        sums = self._sampler.sample(counter, time_ns)
        burst: Frames = self._burst.frames(counter, sums)
        accepted = self.link.send(burst)
        self.frames_sent += accepted
        self.frames_dropped += len(burst) - accepted

    def _nmt(self, data: bytes, now_s: float) -> None:
        if len(data) < 2:
            return
        command, node_id = data[0], data[1]
        for node in self.nodes if node_id == 0 else filter(None, [self._by_id.get(node_id)]):
            node.command(command, now_s)

    def _sdo(self, can_id: int, data: bytes, frame: np.void) -> None:
        node = self._by_id.get(can_id - SDO_REQUEST_BASE)
        if node is None or not node.answers_sdo:
            return
        try:
            self._network.notify(can_id, bytearray(data), int(frame["time_ns"]) * 1e-9)
        except Exception:  # noqa: BLE001 - nothing that arrives may end the receive loop
            self.frames_rejected += 1

    def _compile(self) -> None:
        self._burst = Burst(self.nodes, self._starts)
        for node in self.nodes:
            node.pdo_changed = False
