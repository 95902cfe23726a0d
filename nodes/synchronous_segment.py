"""Nodes that send sums at every SYNC, as one burst."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

import numpy as np

from bus.link import DISCARDED, Send
from dbc.canopen import HIGHEST_NODE_ID, Emergency, NmtState
from dbc.contract import Contract, NodeContract
from dbc.dictionary import REACTION_NS, SkinState
from dbc.frame import Frames
from dbc.frame_bits import frame_time_ns
from dbc.indices import OD_STATE, OD_WINDOW_US
from nodes.burst import Burst
from nodes.node import SkinNode
from nodes.sampler import Sampler
from nodes.segment import Segment
from nodes.tpdo import LiveTpdo

#: The next SYNC is expected within these times after the last SYNC, in periods.
QUIET_FROM, QUIET_TO = 0.7, 2.0
#: Window when 1007h is 0: no limit.
NO_WINDOW_NS: Final = 1 << 62


def expects_sync(since_s: float, period_s: float) -> bool:
    """Tell whether the next SYNC is expected, `since_s` after the last one."""
    return QUIET_FROM * period_s < since_s < QUIET_TO * period_s


class SynchronousSegment(Segment):
    """The synchronous nodes of one bus; parameters as for `Segment`."""

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
        wires = contract.layout.bus[bus]
        self._frame_ns = int(frame_time_ns(contract.cycle(bus), wires.bitrate, wires.data_bitrate, "worst").max())
        self._bus, self._sampler = bus, sampler
        self._sent = self._dropped = 0
        # Latest start of a frame after the SYNC, so that the frame ends inside the window: by node-ID and state, and in
        # the states of the newest SYNC.
        self._window_ns = np.zeros((HIGHEST_NODE_ID + 1, 2), np.int64)
        self._newest_window_ns = np.zeros(HIGHEST_NODE_ID + 1, np.int64)
        super().__init__(contract, bus, node_ids, send, sampler, complain=complain, store=store)
        self._node_ids = [node.contract.node_id for node in self.nodes]

    @property
    def frames_sent(self) -> int:
        """Number of TPDOs that the controllers accepted and did not discard."""
        return self._sent + self._network.pdos_sent

    @property
    def frames_dropped(self) -> int:
        """Number of TPDOs that the controllers refused, or could not send within the window."""
        return self._dropped + self._network.pdos_dropped

    def tick(self, now_s: float) -> None:
        """Do what is due by time, but not while the next SYNC is expected.

        A heartbeat sent while a SYNC waits to be read would delay the burst that answers this SYNC.
        """
        if not expects_sync(now_s - self.sync_at_s, self._period_s):
            super().tick(now_s)

    def take(self, arrived: Frames, now_s: float) -> None:
        """Handle received frames in their order, with echoes of sent frames and discarded frames."""
        self._count_expired(arrived[arrived["flags"] & DISCARDED == DISCARDED])
        super().take(arrived, now_s)

    def _answer(self, counter: int, time_ns: int) -> None:
        sums = self._sampler.sample(counter, time_ns, self._bus)
        operational = np.array([node.state is NmtState.OPERATIONAL for node in self.nodes], np.bool_)
        states = np.array([node.active_state for node in self.nodes], np.intp)
        burst = self._burst.frames(counter, sums, operational, states)
        burst["time_ns"] = time_ns + REACTION_NS
        self._newest_window_ns[self._node_ids] = self._window_ns[self._node_ids, states]
        burst["expires_ns"] = time_ns + self._newest_window_ns[burst["port"]]
        accepted = self._send(burst)
        self._sent += accepted
        self._dropped += len(burst) - accepted
        for node_id, sent in zip(*np.unique(burst["port"][:accepted], return_counts=True), strict=True):
            self._by_id[int(node_id)].health[1] += sent
        for node, tpdo in self._mixed:
            if node.state is NmtState.OPERATIONAL and tpdo.state in (None, node.active_state):
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

    def _compile(self, changed: Collection[SkinNode]) -> None:
        """Split the TPDOs into plain TPDOs, which `Burst` sends as arrays, and the others."""
        super()._compile(changed)
        plain: list[tuple[int, NodeContract, LiveTpdo]] = []
        self._mixed: list[tuple[SkinNode, LiveTpdo]] = []
        self._pdo_ids = [tpdo.cob_id for node in self.nodes for tpdo in node.tpdos]
        for place, node in enumerate(self.nodes):
            window_us = node.local.unsigned(OD_WINDOW_US)
            few_us = window_us if self._contract.recognition is None else node.local.unsigned(OD_STATE, 2)
            self._window_ns[node.contract.node_id, [SkinState.RECOGNITION, SkinState.IMAGES]] = [
                max(1, each_us * 1000 - self._frame_ns) if each_us else NO_WINDOW_NS for each_us in (few_us, window_us)
            ]
            plain += [(place, node.contract, tpdo) for tpdo in node.tpdos if tpdo.is_plain]
            self._mixed += [(node, tpdo) for tpdo in node.tpdos if not tpdo.is_plain]
        self._burst = Burst(self._contract, plain)
