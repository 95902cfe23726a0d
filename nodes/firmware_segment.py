"""All boards of one bus that run the C firmware (`firmware`) in place of `nodes.node`; otherwise as `nodes.segment`."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection

import numpy as np
import numpy.typing as npt

from bus.link import DISCARDED, Send
from dbc.canopen import HEARTBEAT_BASE, LAST_SYNCHRONOUS, SYNC_COB_ID, is_of_node
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from firmware.library import CompiledBoards, Firmware
from nodes.sampler import CountSampler
from nodes.segment import TICK_S
from nodes.synchronous_segment import expects_sync


class BoardsSegment(ABC):
    """What all boards in C have in common.

    Parameters
    ----------
    contract : Contract
    bus : int
        Number of the bus in the layout.
    boards : CompiledBoards
        Those of this bus.
    node_ids : collection of int
    send : callable
        Sends frames on this bus.
    complain : callable
        Takes a line for the log that may repeat often.

    Attributes
    ----------
    frames_sent, frames_dropped : int
        TPDOs that were sent, and TPDOs that were not.
    syncs_seen : int
    sync_at_s : float
        When the newest SYNC was read.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        boards: CompiledBoards,
        node_ids: Collection[int],
        send: Send,
        *,
        complain: Callable[[str], None],
    ) -> None:
        self.frames_sent = self.frames_dropped = self.syncs_seen = 0
        self.sync_at_s = self._tick_at_s = float("-inf")
        self._name = contract.layout.bus[bus].name
        self._period_s = contract.layout.sync.period_s
        self._boards, self._node_ids = boards, node_ids
        nodes = contract.on_bus(bus)
        self._pdo_ids = [tpdo.cob_id for node in nodes for tpdo in node.tpdos]
        self._pdo_ids += [tpdo.cob_id for node in nodes for tpdo in node.adaptive_tpdos]
        self._send = send
        self._complain = complain

    def boot(self, now_s: float) -> None:
        """Boot all boards."""
        self._post(self._boards.power_up(now_s))

    @abstractmethod
    def tick(self, now_s: float) -> None:
        """Do what is due by time."""

    @abstractmethod
    def _count(self, can_id: npt.NDArray[np.uint32], flags: npt.NDArray[np.uint8]) -> None:
        """Count the boards' own TPDOs among received frames."""

    @abstractmethod
    def _answer(self, part: Frames, counter: int, now_s: float) -> None:
        """Pass frames to the boards, the last of which is a SYNC; its counter is 0 without one."""

    def take(self, arrived: Frames, now_s: float) -> None:
        """Handle received frames in their order, with echoes of sent frames and discarded frames."""
        flags, can_id = arrived["flags"], arrived["can_id"]
        self._count(can_id, flags)
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
            self._post(self._boards.take(part, now_s))
            return
        self.syncs_seen += 1
        self.sync_at_s = now_s
        counter = int(sync["data"][0]) if sync["length"] == 1 else 0
        self._answer(part, counter, now_s)

    def _post(self, burst: Frames) -> int:
        """Send frames; those without room are given up. Return how many TPDOs were accepted."""
        if not len(burst):
            return 0
        accepted = self._send(burst)
        is_pdo = np.isin(burst["can_id"], self._pdo_ids)
        self.frames_dropped += int(is_pdo[accepted:].sum())
        if accepted < len(burst):
            self._boards.refuse(burst[accepted:])
        return int(is_pdo[:accepted].sum())


class FirmwareSegment(BoardsSegment):
    """The synchronous boards of one bus.

    Parameters
    ----------
    firmware : Firmware
        Compiled for the boards that this process runs.
    sampler : CountSampler

    The others are those of `BoardsSegment`.
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
        super().__init__(contract, bus, firmware.boards(bus), firmware.node_ids(bus), send, complain=complain)
        self._bus, self._sampler = bus, sampler

    def tick(self, now_s: float) -> None:
        """Do what is due by time, but not while the next SYNC is expected."""
        if now_s < self._tick_at_s or expects_sync(now_s - self.sync_at_s, self._period_s):
            return
        self._tick_at_s = now_s + TICK_S
        self._post(self._boards.pass_time(now_s))

    def _count(self, can_id: npt.NDArray[np.uint32], flags: npt.NDArray[np.uint8]) -> None:
        unsent = int((np.isin(can_id, self._pdo_ids) & (flags & DISCARDED == DISCARDED)).sum())
        self.frames_sent -= unsent
        self.frames_dropped += unsent

    def _answer(self, part: Frames, counter: int, now_s: float) -> None:
        counts = self._sampler.sample(counter, int(part[-1]["time_ns"]), self._bus).astype(np.uint16)
        self._post(self._boards.take(part, now_s, counts))

    def _post(self, burst: Frames) -> int:
        accepted = super()._post(burst)
        self.frames_sent += accepted
        return accepted
