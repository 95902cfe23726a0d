"""All virtual nodes of one bus without input and output: frames and times in, answers out."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from bus.link import Send
from dbc.canopen import (
    HEARTBEAT_BASE,
    LAST_SYNCHRONOUS,
    NMT_BYTES,
    NMT_COB_ID,
    SDO_BYTES,
    SDO_REQUEST_BASE,
    STATE_COB_ID,
    SYNC_COB_ID,
    Emergency,
    NmtCommand,
    NmtState,
    is_of_node,
)
from dbc.configuration import configuration
from dbc.contract import Contract, NodeContract
from dbc.dictionary import SkinState, dictionary
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from dbc.indices import OD_SYNC_OVERFLOW
from nodes.boards import Boards
from nodes.network import SegmentNetwork
from nodes.node import SkinNode
from nodes.storage import Storage

#: Resolution of heartbeats, event timers and inhibit times.
TICK_S: Final = 0.005


class Segment(ABC):
    """The nodes of one bus: what they have in common, however they send their sums.

    Parameters
    ----------
    contract : Contract
    bus : int
        Number of the bus in the layout.
    node_ids : collection of int
        The nodes of the bus that this process runs.
    send : callable
        Sends frames on this bus.
    boards : Boards
    complain : callable
        Takes a line for the log that may repeat often.
    store : Path, optional
        Folder for the parameters that 1010h stores, one file per node; without a folder they end with the process.

    Attributes
    ----------
    frames_rejected : int
        Number of received frames that made the CANopen library raise; they are dropped.
    sync_at_s : float
        When the newest SYNC was read.
    """

    #: What the nodes are; it fits the boards.
    node_type: ClassVar[type[SkinNode]] = SkinNode

    def __init__(
        self,
        contract: Contract,
        bus: int,
        node_ids: Collection[int],
        send: Send,
        boards: Boards,
        *,
        complain: Callable[[str], None],
        store: Path | None = None,
    ) -> None:
        self.frames_rejected = 0
        self.syncs_seen = 0
        self._name = contract.layout.bus[bus].name
        self._complain = complain
        self._contract = contract
        self._period_s = contract.layout.sync.period_s
        self.sync_at_s = self._tick_at_s = float("-inf")
        #: When a node has something to do; a received frame may change that.
        self._due_s = float("-inf")
        #: Identifier of the RPDO with the state of the nodes; without states none has it.
        self._state_cob_id = -1 if contract.recognition is None else STATE_COB_ID
        self._send = send
        self._network = SegmentNetwork(send)
        self.nodes = [
            self._new_node(
                node,
                boards,
                Storage(contract.phi.fingerprint, store / f"{self._name}-{node.node_id}.json" if store else None),
            )
            for node in contract.on_bus(bus)
            if node.node_id in node_ids
        ]
        self._by_id = {node.contract.node_id: node for node in self.nodes}
        self._sync_length: dict[int, int] = {}
        #: The nodes that watch the heartbeat of a node-ID; most nodes watch none.
        self._watchers: dict[int, list[SkinNode]] = {}
        self._compile(self.nodes)

    @property
    @abstractmethod
    def frames_sent(self) -> int:
        """Number of TPDOs that were sent."""

    @property
    @abstractmethod
    def frames_dropped(self) -> int:
        """Number of TPDOs that were given up."""

    @abstractmethod
    def _answer(self, counter: int, time_ns: int) -> None:
        """Do what a SYNC asks for; its counter is 0 without one."""

    def _new_node(self, node: NodeContract, boards: Boards, storage: Storage) -> SkinNode:
        return self.node_type(
            node,
            dictionary(self._contract, node),
            configuration(self._contract, node),
            network=self._network,
            boards=boards,
            storage=storage,
        )

    def boot(self, now_s: float) -> None:
        """Boot all nodes."""
        self._due_s = float("-inf")
        for node in self.nodes:
            node.boot(now_s)
        self._compile(self.nodes)

    def tick(self, now_s: float) -> None:
        """Do what is due by time."""
        if now_s < self._tick_at_s or now_s < self._due_s:
            return
        self._tick_at_s = now_s + TICK_S
        next_s = float("inf")
        for node in self.nodes:
            due_s = node.due_s
            if now_s >= due_s:
                node.tick(now_s)
                due_s = node.due_s
            next_s = min(next_s, due_s)
        self._due_s = next_s

    def take(self, arrived: Frames, now_s: float) -> None:
        """Handle received frames in their order, with echoes of sent frames and discarded frames."""
        can_id = arrived["can_id"]
        there = arrived["flags"] & (ERROR | EXTENDED | REMOTE) == 0
        plain = there & (arrived["flags"] & ECHO == 0)
        heartbeat = is_of_node(can_id, HEARTBEAT_BASE)
        request = is_of_node(can_id, SDO_REQUEST_BASE)
        # The nodes of this segment receive each other's heartbeats as echoes.
        others = (can_id == SYNC_COB_ID) | (can_id == NMT_COB_ID) | (can_id == self._state_cob_id)
        for frame in arrived[there & heartbeat | plain & (request | others)]:
            self._handle(frame, now_s)

    def _handle(self, frame: np.void, now_s: float) -> None:
        can_id = int(frame["can_id"])
        if can_id > HEARTBEAT_BASE:
            self._heartbeat(can_id - HEARTBEAT_BASE, bool(frame["flags"] & ECHO), now_s)
            return
        self._due_s = float("-inf")
        data = frame["data"][: frame["length"]].tobytes()
        if can_id == SYNC_COB_ID:
            self._sync(data, int(frame["time_ns"]), now_s)
        elif can_id == NMT_COB_ID:
            self._nmt(data, now_s)
        elif can_id == self._state_cob_id:
            self._switch(data)
        elif len(data) == SDO_BYTES:
            self._sdo(can_id, data, now_s)

    def _heartbeat(self, node_id: int, is_echo: bool, now_s: float) -> None:
        if node_id in self._by_id and not is_echo:
            self._complain(f"node-ID {node_id} is on {self._name} twice")
        for node in self._watchers.get(node_id, ()):
            node.heard(node_id, now_s)
            self._due_s = float("-inf")

    def _sync(self, data: bytes, time_ns: int, now_s: float) -> None:
        if len(data) == 1 and not 1 <= data[0] <= LAST_SYNCHRONOUS:
            return  # no counter of CiA 301, 7.2.5.2
        self.syncs_seen += 1
        self.sync_at_s = now_s
        listening = [node for node in self.nodes if node.state is NmtState.OPERATIONAL]
        self._judge_sync(listening, len(data))
        counter = data[0] if len(data) == 1 else 0
        for node in listening:
            node.take_sync()
        self._answer(counter, time_ns)

    def _judge_sync(self, listening: list[SkinNode], length: int) -> None:
        """Report a SYNC whose length does not agree with 1019h (CiA 301, 7.2.5.2: EMCY 8240h)."""
        for node in listening:
            node.health[0] += 1
            if length == self._sync_length[node.contract.node_id]:
                node.emcy.gone(Emergency.SYNC_LENGTH)
            else:
                node.emcy.raised(Emergency.SYNC_LENGTH, length)

    def _switch(self, data: bytes) -> None:
        """Take the RPDO with the state of all nodes; nodes that are not operational take no PDO."""
        if len(data) == 1 and data[0] in (SkinState.RECOGNITION, SkinState.IMAGES):
            for node in self.nodes:
                if node.state is NmtState.OPERATIONAL:
                    node.switch(SkinState(data[0]))

    def _nmt(self, data: bytes, now_s: float) -> None:
        if len(data) != NMT_BYTES:
            return
        command, node_id = data[0], data[1]
        addressed = self.nodes if node_id == 0 else [self._by_id[node_id]] if node_id in self._by_id else []
        for node in addressed:
            node.command(command, now_s)
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self._compile(addressed)

    def _sdo(self, can_id: int, data: bytes, now_s: float) -> None:
        node = self._by_id.get(can_id - SDO_REQUEST_BASE)
        if node is None or not node.answers_sdo:
            return
        try:
            self._network.notify(can_id, bytearray(data), now_s)
        except Exception:  # noqa: BLE001 - no received frame may end the receive loop
            self.frames_rejected += 1
        if node.refresh(now_s):
            self._compile([node])

    def _compile(self, changed: Collection[SkinNode]) -> None:
        """Read what the segment needs to know of nodes whose dictionaries have changed."""
        for node in changed:
            self._sync_length[node.contract.node_id] = 1 if node.local.unsigned(OD_SYNC_OVERFLOW) else 0
        self._watchers = {}
        for node in self.nodes:
            for node_id in node.watched.watches:
                self._watchers.setdefault(node_id, []).append(node)
