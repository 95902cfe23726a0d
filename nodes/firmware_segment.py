"""All boards of one bus that run the C firmware (`firmware`) in place of `nodes.node`; otherwise as `nodes.segment`."""

from collections.abc import Callable

import numpy as np

from bus.link import DISCARDED, Send
from dbc.canopen import HEARTBEAT_BASE, LAST_SYNCHRONOUS, SYNC_COB_ID, is_of_node
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from firmware.library import Firmware
from nodes.sampler import CountSampler
from nodes.segment import TICK_S
from nodes.synchronous_segment import expects_sync


class FirmwareSegment:
    """The boards of one bus.

    Parameters
    ----------
    contract : Contract
    bus : int
        Number of the bus in the layout.
    firmware : Firmware
        Compiled for the boards that this process runs.
    send : callable
        Sends frames on this bus.
    sampler : CountSampler
    complain : callable
        Takes a line for the log that may repeat often.

    Attributes
    ----------
    frames_sent, frames_dropped : int
        TPDOs that the controllers accepted and did not discard, and the others.
    syncs_seen : int
    sync_at_s : float
        When the newest SYNC was read.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        firmware: Firmware,
        send: Send,
        sampler: CountSampler,
        *,
        complain: Callable[[str], None],
    ) -> None:
        self.frames_sent = self.frames_dropped = self.syncs_seen = 0
        self.sync_at_s = self._tick_at_s = float("-inf")
        self._name = contract.layout.bus[bus].name
        self._period_s = contract.layout.sync.period_s
        self._boards = firmware.boards(bus)
        self._node_ids = firmware.node_ids(bus)
        self._pdo_ids = [tpdo.cob_id for node in contract.on_bus(bus) for tpdo in node.tpdos]
        self._send = send
        self._bus, self._sampler = bus, sampler
        self._complain = complain

    def boot(self, now_s: float) -> None:
        """Boot all boards."""
        self._post(self._boards.power_up(now_s), now_s)

    def tick(self, now_s: float) -> None:
        """Do what is due by time, but not while the next SYNC is expected."""
        if now_s < self._tick_at_s or expects_sync(now_s - self.sync_at_s, self._period_s):
            return
        self._tick_at_s = now_s + TICK_S
        self._post(self._boards.pass_time(now_s), now_s)

    def take(self, arrived: Frames, now_s: float) -> None:
        """Handle received frames in their order, with echoes of sent frames and discarded frames."""
        flags, can_id = arrived["flags"], arrived["can_id"]
        unsent = int((np.isin(can_id, self._pdo_ids) & (flags & DISCARDED == DISCARDED)).sum())
        self.frames_sent -= unsent
        self.frames_dropped += unsent
        others = flags & (ERROR | EXTENDED | REMOTE | ECHO) == 0
        for node_id in can_id[others & is_of_node(can_id, HEARTBEAT_BASE)] - HEARTBEAT_BASE:
            if node_id in self._node_ids:
                self._complain(f"node-ID {node_id} is on {self._name} twice")
        is_sync = others & (can_id == SYNC_COB_ID)
        begin = 0
        for end in [*(np.flatnonzero(is_sync) + 1), len(arrived)]:
            if begin < end:
                self._pass(arrived[begin:end], now_s, has_sync=bool(is_sync[end - 1]))
            begin = int(end)

    def _pass(self, part: Frames, now_s: float, *, has_sync: bool) -> None:
        """Pass frames to the boards; a SYNC is the last of them."""
        sync = part[-1]
        if not has_sync or (sync["length"] == 1 and not 1 <= sync["data"][0] <= LAST_SYNCHRONOUS):
            self._post(self._boards.take(part, now_s), now_s)
            return
        self.syncs_seen += 1
        self.sync_at_s = now_s
        counter = int(sync["data"][0]) if sync["length"] == 1 else 0
        counts = self._sampler.sample(counter, int(sync["time_ns"]), self._bus).astype(np.uint16)
        self._post(self._boards.take(part, now_s, counts), now_s)

    def _post(self, burst: Frames, now_s: float) -> None:
        """Send frames; those without room are given up."""
        if not len(burst):
            return
        accepted = self._send(burst)
        is_pdo = np.isin(burst["can_id"], self._pdo_ids)
        self.frames_sent += int(is_pdo[:accepted].sum())
        self.frames_dropped += int(is_pdo[accepted:].sum())
        if accepted < len(burst):
            refused = burst[accepted:].copy()
            refused["flags"] |= DISCARDED
            self._boards.take(refused, now_s)
