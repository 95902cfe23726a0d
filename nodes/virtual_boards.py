"""The nodes of one bus in Python: frames and times in, answers out."""

from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from bus.link import DISCARDED
from dbc import indices as od
from dbc.canopen import (
    BASE_ID_MASK,
    HEARTBEAT_BASE,
    HIGHEST_NODE_ID,
    LSS_REQUEST_COB_ID,
    NMT_BYTES,
    NMT_COB_ID,
    NO_NODE_ID,
    SDO_BYTES,
    SDO_REQUEST_BASE,
    Emergency,
    NmtCommand,
    NmtState,
    is_of_node,
)
from dbc.contract import Contract, NodeContract
from dbc.dictionary import REACTION_NS
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from nodes.burst import Burst
from nodes.hardware import Hardware
from nodes.node import SkinNode
from nodes.objects import Outbox
from nodes.tpdo import LiveTpdo
from nodes.virtual_board import VirtualBoard

#: Window when 1007h is 0: no limit.
NO_WINDOW_NS: Final = 1 << 62


class VirtualBoards:
    """The nodes of one bus.

    Parameters
    ----------
    bus : int
        Number of the bus in the layout.
    node_ids : collection of int
        The nodes of the bus that this process runs.
    hardware : Hardware
        Made for the way in which the layout sends (`nodes.sending`).
    store : Path, optional
        Folder for the parameters that 1010h stores, one file per node; without a folder they end with the process.
    unnumbered : bool
        Whether the nodes wait for LSS to give them their node-IDs, unless `store` has them.

    Attributes
    ----------
    is_pdo : array of bool, shape (BASE_ID_MASK + 1,)
        Whether an identifier is that of a TPDO of these nodes now.
    due_s : float
        When a node has something to do; a received frame may change that.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        node_ids: Collection[int],
        hardware: Hardware,
        *,
        store: Path | None = None,
        unnumbered: bool = False,
    ) -> None:
        self.is_pdo = np.zeros(BASE_ID_MASK + 1, np.bool_)
        self.due_s = float("-inf")
        self._contract = contract
        self._outbox = Outbox()
        self._boards = [
            VirtualBoard(contract, each, hardware, self._outbox, store=store, unnumbered=unnumbered)
            for each in contract.on_bus(bus)
            if each.node_id in node_ids
        ]
        self._sync_length: dict[int, int] = {}
        #: The nodes that watch the heartbeat of a node-ID; most nodes watch none.
        self._watchers: dict[int, list[SkinNode]] = {}
        self._frame_ns = contract.longest_ns(bus)
        # Latest start of a frame after the SYNC, so that the frame ends inside the window: by node-ID.
        self._window_ns = np.zeros(HIGHEST_NODE_ID + 1, np.int64)
        self._compile(self.nodes)

    @property
    def nodes(self) -> list[SkinNode]:
        """What the boards are by their node-IDs."""
        return [board.node for board in self._boards]

    @property
    def node_ids(self) -> Collection[int]:
        """The node-IDs of the nodes."""
        return self._by_id.keys()

    def power_up(self, now_s: float) -> Frames:
        """Boot all nodes that have a node-ID."""
        self.due_s = float("-inf")
        for board in self._boards:
            board.power_up(now_s)
        self._compile(self.nodes)
        return self._outbox.take()

    def pass_time(self, now_s: float) -> Frames:
        """Do what is due by time."""
        next_s = float("inf")
        for node in self.nodes:
            due_s = node.due_s
            if now_s >= due_s:
                node.tick(now_s)
                due_s = node.due_s
            next_s = min(next_s, due_s)
        self.due_s = next_s
        return self._outbox.take()

    def take(self, arrived: Frames, now_s: float) -> Frames:
        """Take received frames, with echoes of sent frames and discarded frames."""
        can_id, flags = arrived["can_id"], arrived["flags"]
        unsent = arrived[flags & DISCARDED == DISCARDED]
        # A controller in bus-off discards other frames, too.
        if len(unsent):
            self.due_s = float("-inf")
            for node, count in self._of_nodes(unsent[self.is_pdo[unsent["can_id"] & BASE_ID_MASK]]):
                node.expired(count)
        there = flags & (ERROR | EXTENDED | REMOTE) == 0
        plain = there & (flags & ECHO == 0)
        heartbeat = is_of_node(can_id, HEARTBEAT_BASE)
        request = is_of_node(can_id, SDO_REQUEST_BASE)
        # The nodes of this process receive each other's heartbeats as echoes.
        others = (can_id == NMT_COB_ID) | (can_id == LSS_REQUEST_COB_ID)
        for frame in arrived[there & heartbeat | plain & (request | others)]:
            self._handle(frame, now_s)
        return self._outbox.take()

    def refuse(self, burst: Frames) -> None:
        """Take note of frames that found no room in the transmit queue."""
        for frame in burst[self.is_pdo[burst["can_id"]]]:
            self._by_id[int(frame["port"])].refused(int(frame["can_id"]))

    def _of_nodes(self, burst: Frames) -> list[tuple[SkinNode, int]]:
        """Return the nodes that have sent frames, and the number of frames of each."""
        node_ids, counts = np.unique(burst["port"], return_counts=True)
        found = zip(node_ids.tolist(), counts.tolist(), strict=True)
        return [(self._by_id[node_id], count) for node_id, count in found if node_id in self._by_id]

    def _handle(self, frame: np.void, now_s: float) -> None:
        can_id = int(frame["can_id"])
        if can_id == LSS_REQUEST_COB_ID:
            self._take_lss(frame["data"][: frame["length"]].tobytes(), now_s)
            return
        if can_id > HEARTBEAT_BASE:
            for node in self._watchers.get(can_id - HEARTBEAT_BASE, ()):
                node.heard(can_id - HEARTBEAT_BASE, now_s)
                self.due_s = float("-inf")
            return
        self.due_s = float("-inf")
        data = frame["data"][: frame["length"]].tobytes()
        if can_id == NMT_COB_ID:
            self._nmt(data, now_s)
        elif len(data) == SDO_BYTES:
            self._sdo(can_id, data, now_s)

    def answer(self, sync: Frames, now_s: float, measured: npt.NDArray[np.int32] | None) -> Frames:  # noqa: ARG002
        """Take a SYNC; answer with the sums of now, where the nodes send at SYNC."""
        length = int(sync["length"][0])
        listening = [node for node in self.nodes if node.state is NmtState.OPERATIONAL]
        self._judge_sync(listening, length)
        if measured is not None:
            counter = int(sync["data"][0, 0]) if length == 1 else 0
            for node in self.nodes:
                node.sync_counter = counter
            self._send_sums(counter, int(sync["time_ns"][0]), measured)
        return self._outbox.take()

    def _send_sums(self, counter: int, time_ns: int, sums: npt.NDArray[np.int32]) -> None:
        operational = np.array([node.state is NmtState.OPERATIONAL for node in self.nodes], np.bool_)
        burst = self._burst.frames(counter, sums, operational)
        for node_id in burst["port"].tolist():
            self._by_id[node_id].health[1] += 1
        others: list[Frames] = []
        for node, tpdo in self._mixed:
            if node.state is NmtState.OPERATIONAL:
                payload = tpdo.at_sync(counter, node.local)
                if payload is not None:
                    others.append(node.tpdo_frame(tpdo, payload))
        burst = np.concatenate((burst, *others)) if others else burst
        burst["time_ns"] = time_ns + REACTION_NS
        burst["expires_ns"] = time_ns + self._window_ns[burst["port"]]
        self._outbox.post(burst)

    def _judge_sync(self, listening: list[SkinNode], length: int) -> None:
        """Report a SYNC whose length does not agree with 1019h (CiA 301, 7.2.5.2: EMCY 8240h)."""
        for node in listening:
            node.count_sync()
            if length == self._sync_length[node.contract.node_id]:
                node.emcy.gone(Emergency.SYNC_LENGTH)
            else:
                node.emcy.raised(Emergency.SYNC_LENGTH, length)
            if node.emcy.is_waiting:
                self.due_s = float("-inf")

    def _nmt(self, data: bytes, now_s: float) -> None:
        if len(data) != NMT_BYTES:
            return
        command, node_id = data[0], data[1]
        # Without node-ID there is no NMT slave yet.
        numbered = [board for board in self._boards if board.slave.node_id != NO_NODE_ID]
        addressed = [board for board in numbered if node_id in {0, board.slave.node_id}]
        for board in addressed:
            board.command(command, now_s)
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self._compile([board.node for board in addressed])

    def _take_lss(self, data: bytes, now_s: float) -> None:
        for board in self._boards:
            if board.take_lss(data, now_s):
                self.due_s = float("-inf")
                self._compile([board.node])

    def _sdo(self, can_id: int, data: bytes, now_s: float) -> None:
        node = self._by_id.get(can_id - SDO_REQUEST_BASE)
        if node is None or not node.answers_sdo:
            return
        with suppress(Exception):  # no received frame may end the receive loop
            self._outbox.notify(can_id, bytearray(data), now_s)
        if node.refresh(now_s):
            self._compile([node])

    def _compile(self, changed: Collection[SkinNode]) -> None:
        """Read what has to be known of nodes whose dictionaries have changed.

        Plain TPDOs are sent as arrays (`Burst`), the others one by one.
        """
        # A silent node may be of a node-ID that another board has.
        by_state = sorted(self.nodes, key=lambda node: node.state is not NmtState.INITIALISING)
        self._by_id = {node.contract.node_id: node for node in by_state}
        for node in changed:
            self._sync_length[node.contract.node_id] = 1 if node.local.unsigned(od.SYNC_OVERFLOW) else 0
        self._watchers = {}
        self.is_pdo[:] = False
        plain: list[tuple[int, NodeContract, LiveTpdo]] = []
        self._mixed: list[tuple[SkinNode, LiveTpdo]] = []
        for place, node in enumerate(self.nodes):
            if self._by_id[node.contract.node_id] is not node:
                continue
            for node_id in node.watched.watches:
                self._watchers.setdefault(node_id, []).append(node)
            self.is_pdo[node.pdo_ids] = True
            window_us = node.local.unsigned(od.WINDOW_US)
            self._window_ns[node.contract.node_id] = (
                max(1, window_us * 1000 - self._frame_ns) if window_us else NO_WINDOW_NS
            )
            plain += [(place, node.contract, tpdo) for tpdo in node.tpdos if tpdo.is_plain]
            self._mixed += [(node, tpdo) for tpdo in node.tpdos if not tpdo.is_plain]
        self._burst = Burst(self._contract, plain)
