"""All virtual nodes of one bus without input and output: frames and times in, answers out."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

import numpy as np

from bus.link import DISCARDED, Send
from dbc.canopen import (
    HEARTBEAT_BASE,
    HIGHEST_NODE_ID,
    LAST_SYNCHRONOUS,
    NMT_BYTES,
    NMT_COB_ID,
    SDO_BYTES,
    SDO_REQUEST_BASE,
    SYNC_COB_ID,
    Emergency,
    NmtCommand,
    NmtState,
    is_of_node,
)
from dbc.configuration import configuration
from dbc.contract import Contract, NodeContract
from dbc.dictionary import dictionary
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from dbc.frame_bits import frame_time_ns
from dbc.indices import OD_SYNC_OVERFLOW, OD_WINDOW_US
from nodes.burst import Burst
from nodes.network import SegmentNetwork
from nodes.node import SkinNode
from nodes.sampler import Sampler
from nodes.storage import Storage
from nodes.tpdo import Tpdo

#: Time from the end of the SYNC frame to a node's answer, on the clock of the bus; typical of a microcontroller.
REACTION_NS: Final = 100_000
#: Resolution of heartbeats, event timers and inhibit times.
TICK_S: Final = 0.005
#: The next SYNC is expected within these times after the last SYNC, in periods.
QUIET_FROM, QUIET_TO = 0.7, 2.0
#: Window when 1007h is 0: no limit.
NO_WINDOW_NS: Final = 1 << 62


class Segment:
    """The nodes of one bus.

    Parameters
    ----------
    contract : Contract
    bus : int
        Number of the bus in the layout.
    node_ids : collection of int
        The nodes of the bus that this process runs.
    send : callable
        Sends frames on this bus.
    sampler : Sampler
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

    def __init__(
        self,
        contract: Contract,
        bus: int,
        node_ids: Collection[int],
        send: Send,
        sampler: Sampler,
        *,
        complain: Callable[[str], None],
        store: Path | None = None,
    ) -> None:
        self.frames_rejected = 0
        self.syncs_seen = 0
        self._sent = self._dropped = 0
        self._name = contract.layout.bus[bus].name
        self._complain = complain
        wires = contract.layout.bus[bus]
        self._frame_ns = int(frame_time_ns(contract.cycle(bus), wires.bitrate, wires.data_bitrate, "worst").max())
        self._contract = contract
        self._period_s = contract.layout.sync.period_s
        self.sync_at_s = self._tick_at_s = float("-inf")
        self._sampler = sampler
        self._send = send
        self._network = SegmentNetwork(send)
        self.nodes = [
            SkinNode(
                node,
                dictionary(contract, node),
                configuration(contract, node),
                network=self._network,
                sampler=sampler,
                storage=Storage(
                    contract.phi.fingerprint, store / f"{self._name}-{node.node_id}.json" if store else None
                ),
            )
            for node in contract.on_bus(bus)
            if node.node_id in node_ids
        ]
        self._by_id = {node.contract.node_id: node for node in self.nodes}
        self._compile()

    @property
    def frames_sent(self) -> int:
        """Number of TPDOs that the controllers accepted and did not discard."""
        return self._sent + self._network.pdos_sent

    @property
    def frames_dropped(self) -> int:
        """Number of TPDOs that the controllers refused, or could not send within the window."""
        return self._dropped + self._network.pdos_dropped

    def boot(self, now_s: float) -> None:
        """Boot all nodes."""
        for node in self.nodes:
            node.boot(now_s)
        self._compile()

    def tick(self, now_s: float) -> None:
        """Do what is due by time, but not while the next SYNC is expected.

        A heartbeat sent while a SYNC waits to be read would delay the burst that answers this SYNC.
        """
        since_s = now_s - self.sync_at_s
        quiet = QUIET_FROM * self._period_s < since_s < QUIET_TO * self._period_s
        if quiet or now_s < self._tick_at_s:
            return
        self._tick_at_s = now_s + TICK_S
        for node in self.nodes:
            if node.wants(now_s):
                node.tick(now_s)

    def take(self, arrived: Frames, now_s: float) -> None:
        """Handle received frames in their order, with echoes of sent frames and discarded frames."""
        self._count_expired(arrived[arrived["flags"] & DISCARDED == DISCARDED])
        can_id = arrived["can_id"]
        there = arrived["flags"] & (ERROR | EXTENDED | REMOTE) == 0
        plain = there & (arrived["flags"] & ECHO == 0)
        heartbeat = is_of_node(can_id, HEARTBEAT_BASE)
        request = is_of_node(can_id, SDO_REQUEST_BASE)
        # The nodes of this segment receive each other's heartbeats as echoes.
        for frame in arrived[there & heartbeat | plain & (request | (can_id == SYNC_COB_ID) | (can_id == NMT_COB_ID))]:
            self._handle(frame, now_s)

    def _handle(self, frame: np.void, now_s: float) -> None:
        can_id = int(frame["can_id"])
        data = frame["data"][: frame["length"]].tobytes()
        if can_id == SYNC_COB_ID:
            self._sync(data, int(frame["time_ns"]), now_s)
        elif can_id == NMT_COB_ID:
            self._nmt(data, now_s)
        elif can_id > HEARTBEAT_BASE:
            if can_id - HEARTBEAT_BASE in self._by_id and not frame["flags"] & ECHO:
                self._complain(f"node-ID {can_id - HEARTBEAT_BASE} is on {self._name} twice")
            for node in self.nodes:
                node.heard(can_id - HEARTBEAT_BASE, now_s)
        elif len(data) == SDO_BYTES:
            self._sdo(can_id, data, now_s)

    def _sync(self, data: bytes, time_ns: int, now_s: float) -> None:
        if len(data) == 1 and not 1 <= data[0] <= LAST_SYNCHRONOUS:
            return  # no counter of CiA 301, 7.2.5.2
        self.syncs_seen += 1
        self.sync_at_s = now_s
        listening = [node for node in self.nodes if node.state is NmtState.OPERATIONAL]
        self._judge_sync(listening, len(data))
        counter = data[0] if len(data) == 1 else 0
        sums = self._sampler.sample(counter, time_ns)
        operational = np.array([node.state is NmtState.OPERATIONAL for node in self.nodes], np.bool_)
        burst = self._burst.frames(counter, sums, operational)
        burst["time_ns"] = time_ns + REACTION_NS
        burst["expires_ns"] = time_ns + self._window_ns[burst["port"]]
        accepted = self._send(burst)
        self._sent += accepted
        self._dropped += len(burst) - accepted
        for node_id, sent in zip(*np.unique(burst["port"][:accepted], return_counts=True), strict=True):
            self._by_id[int(node_id)].health[1] += sent
        for node, tpdo in self._mixed:
            if node.state is NmtState.OPERATIONAL:
                payload = tpdo.at_sync(counter, node.local)
                if payload is not None:
                    node.send(tpdo, payload)

    def _count_expired(self, unsent: Frames) -> None:
        """Count and report the TPDOs that could not be sent within the window (1007h)."""
        if not len(unsent):
            return
        unsent = unsent[np.isin(unsent["can_id"], self._pdo_ids)]  # a controller in bus-off discards other frames, too
        self._sent -= len(unsent)
        self._dropped += len(unsent)
        for node_id, count in zip(*np.unique(unsent["port"], return_counts=True), strict=True):
            node = self._by_id.get(int(node_id))
            if node is not None:
                node.health[2] += count
                node.emcy.raised(Emergency.WINDOW_MISSED, int(node.health[2]))

    def _judge_sync(self, listening: list[SkinNode], length: int) -> None:
        """Report a SYNC whose length does not agree with 1019h (CiA 301, 7.2.5.2: EMCY 8240h)."""
        for node in listening:
            node.health[0] += 1
            if length == self._sync_length[node.contract.node_id]:
                node.emcy.gone(Emergency.SYNC_LENGTH)
            else:
                node.emcy.raised(Emergency.SYNC_LENGTH, length)

    def _nmt(self, data: bytes, now_s: float) -> None:
        if len(data) != NMT_BYTES:
            return
        command, node_id = data[0], data[1]
        for node in self.nodes if node_id == 0 else filter(None, [self._by_id.get(node_id)]):
            node.command(command, now_s)
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self._compile()

    def _sdo(self, can_id: int, data: bytes, now_s: float) -> None:
        node = self._by_id.get(can_id - SDO_REQUEST_BASE)
        if node is None or not node.answers_sdo:
            return
        try:
            self._network.notify(can_id, bytearray(data), now_s)
        except Exception:  # noqa: BLE001 - no received frame may end the receive loop
            self.frames_rejected += 1
        if node.refresh(now_s):
            self._compile()

    def _compile(self) -> None:
        """Split the TPDOs into plain TPDOs, which `Burst` sends as arrays, and the others."""
        plain: list[tuple[int, NodeContract, Tpdo]] = []
        self._mixed: list[tuple[SkinNode, Tpdo]] = []
        self._sync_length: dict[int, int] = {}
        self._pdo_ids = [tpdo.cob_id for node in self.nodes for tpdo in node.tpdos]
        # Latest start of a frame after the SYNC, so that the frame ends inside the window.
        self._window_ns = np.zeros(HIGHEST_NODE_ID + 1, np.int64)
        for place, node in enumerate(self.nodes):
            node_id = node.contract.node_id
            self._sync_length[node_id] = 1 if node.local.unsigned(OD_SYNC_OVERFLOW) else 0
            window_us = node.local.unsigned(OD_WINDOW_US)
            self._window_ns[node_id] = max(1, window_us * 1000 - self._frame_ns) if window_us else NO_WINDOW_NS
            plain += [(place, node.contract, tpdo) for tpdo in node.tpdos if tpdo.is_plain]
            self._mixed += [(node, tpdo) for tpdo in node.tpdos if not tpdo.is_plain]
        self._burst = Burst(self._contract, plain)
