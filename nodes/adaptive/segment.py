"""The adaptive nodes of one bus: they send when they have news."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import cast

import numpy as np

from bus.link import Send
from dbc.adaptive import TPDOS
from dbc.canopen import BASE_ID_MASK, NmtState
from dbc.contract import Contract, frame_flags
from dbc.frame import Frames, frames
from nodes.adaptive.boards import AdaptiveBoards, tpdo_places
from nodes.adaptive.controllers import frame_buffer
from nodes.adaptive.node import AdaptiveNode
from nodes.adaptive.timing import MOST_FRAMES, SendingTimes
from nodes.node import SkinNode
from nodes.segment import Segment


class AdaptiveSegment(Segment):
    """The adaptive nodes of one bus; parameters as for `Segment`."""

    node_type = AdaptiveNode

    def __init__(
        self,
        contract: Contract,
        bus: int,
        node_ids: Collection[int],
        send: Send,
        boards: AdaptiveBoards,
        *,
        complain: Callable[[str], None],
        store: Path | None = None,
    ) -> None:
        rows = [boards.row(node.block) for node in contract.on_bus(bus) if node.node_id in node_ids]
        self._first, self._last = min(rows, default=0), max(rows, default=-1) + 1
        self._adaptive = boards
        self._sent = self._dropped = 0
        line = contract.layout.bus[bus]
        self._times = SendingTimes(contract, bus)
        self._decision = 0
        self._room = frame_buffer(MOST_FRAMES)
        self._burst = frames(MOST_FRAMES)
        self._burst["flags"] = frame_flags(line)
        self._cob_ids = np.zeros((self._last - self._first, TPDOS), np.int64)
        self._place_of = np.full(BASE_ID_MASK + 1, -1, np.int64)
        self._node_id = np.zeros(self._last, np.uint16)
        super().__init__(contract, bus, node_ids, send, boards, complain=complain, store=store)

    @property
    def frames_sent(self) -> int:
        """Number of TPDOs that came back as echoes."""
        return self._sent

    @property
    def frames_dropped(self) -> int:
        """Number of TPDOs that a full transmit queue refused."""
        return self._dropped

    def take(self, arrived: Frames, now_s: float) -> None:
        """Handle received frames: first the echoes of sums, then all others in their order."""
        sent, others = self._adaptive.take_echoes(arrived, self._place_of)
        self._sent += sent
        if others:
            super().take(arrived, now_s)

    def tick(self, now_s: float) -> None:
        """Sample what is due, on all buses of the process; send what is most urgent; do what is due by time."""
        self._adaptive.advance(now_s)
        if now_s >= max(self._tick_at_s, self._due_s):
            super().tick(now_s)
            self._note_states()  # a node may have lost another one's heartbeat
        if self._adaptive.decision != self._decision:
            self._decision = self._adaptive.decision
            if self._adaptive.has_due:
                self._send_sums(round(now_s * 1e9))

    def _send_sums(self, now_ns: int) -> None:
        """Give the bus the frames that can win it until the next decision, and a few more."""
        times = self._times.next(now_ns, self._adaptive.pace_ns)
        if times is None:
            return
        until_ns, most = times
        count = self._adaptive.choose(self._first, self._last, until_ns, most, self._room)
        if not count:
            return
        room, burst = self._room, self._burst[:count]
        burst["time_ns"], burst["expires_ns"] = now_ns, until_ns
        burst["can_id"], burst["port"] = room.can_id[:count], self._node_id[room.node[:count]]
        burst["length"], burst["data"] = room.length[:count], room.payload[:count]
        accepted = self._send(burst)
        if accepted < count:
            self._dropped += count - accepted
            self._adaptive.refuse(room.node[accepted:count], room.tpdo[accepted:count])

    def boot(self, now_s: float) -> None:
        """Boot all nodes."""
        super().boot(now_s)
        self._note_states()

    def _answer(self, counter: int, time_ns: int) -> None:
        """Leave the bus to others for a while; the first SYNC tells when the touch began."""
        self._times.sync_ns = time_ns
        self._adaptive.touched_from(time_ns - max(0, counter - 1) * self._times.period_ns)

    def _nmt(self, data: bytes, now_s: float) -> None:
        super()._nmt(data, now_s)
        self._note_states()

    def _note_states(self) -> None:
        for node in self.nodes:
            self._adaptive.set_operational(node.contract.block, node.state is NmtState.OPERATIONAL)

    def _compile(self, changed: Collection[SkinNode]) -> None:
        """Read the TPDOs of nodes whose dictionaries have changed."""
        super()._compile(changed)
        for node in cast("Collection[AdaptiveNode]", changed):
            row = self._adaptive.row(node.contract.block)
            self._node_id[row] = node.contract.node_id
            cob_ids, inhibits = node.communication()
            self._cob_ids[row - self._first] = cob_ids
            self._adaptive.set_tpdos(node.contract.block, cob_ids, inhibits)
        tpdo_places(self._cob_ids, self._first, self._place_of)
