"""What the gateway knows of each bus besides the sums: how full it is and how its nodes are."""

import time
from typing import Final

import numpy as np
import numpy.typing as npt

from bus.link import Link
from dbc.contract import EMCY_BASE, HEARTBEAT_BASE, HIGHEST_NODE_ID, OPERATIONAL, SYNC_COB_ID, Contract
from dbc.frame import ERROR, Frames, frames
from dbc.frame_bits import frame_time_ns
from skin.messages import BusState

#: Reported instead of an NMT state while a node is silent.
SILENT: Final = 255
#: Error code, error register and five bytes of the manufacturer (CiA 301, 7.2.7.2).
EMCY_BYTES: Final = 8
#: A node is silent when its heartbeat is missing for this many periods.
PATIENCE: Final = 1.5


class BusMonitor:
    """Load and heartbeats of one bus.

    The load is the time its frames took, with exact stuffing, over the time that passed.
    """

    def __init__(self, contract: Contract, bus: int, heartbeat_s: float) -> None:
        self._layout = contract.layout.bus[bus]
        frame_time_ns(frames(1), self._layout.bitrate, self._layout.data_bitrate)  # compiled before the first cycle
        self.node_ids = [node.node_id for node in contract.on_bus(bus)]
        self._silent_after_s = PATIENCE * heartbeat_s
        self._nmt = np.full(len(self.node_ids), SILENT, np.uint8)
        self._heard_s = np.full(len(self.node_ids), -np.inf)
        self._emcy = [0] * len(self.node_ids)
        self._unaccounted: list[Frames] = []
        self._busy_ns = 0
        self._since_s = time.monotonic()
        self._total_busy_ns = 0
        self._start_s = self._since_s
        #: Node-ID and error code of the emergencies since the last look.
        self.emergencies: list[tuple[int, int]] = []
        #: SYNCs of somebody else since the last look.
        self.foreign_syncs = 0
        #: Node-IDs whose boot-up message has come since the last look.
        self.booted: set[int] = set()

    def take(self, arrived: Frames) -> None:
        """Account for frames seen on the bus, own ones included."""
        self._unaccounted.append(arrived)
        can_id = arrived["can_id"]
        beats = (can_id > HEARTBEAT_BASE) & (can_id <= HEARTBEAT_BASE + HIGHEST_NODE_ID) & (arrived["length"] == 1)
        plain = arrived["flags"] == 0
        for frame in arrived[beats & plain]:
            self._beat(int(frame["can_id"]) - HEARTBEAT_BASE, int(frame["data"][0]) & 0x7F)
        self.foreign_syncs += int(np.count_nonzero(plain & (can_id == SYNC_COB_ID)))
        emcy = (can_id > EMCY_BASE) & (can_id <= EMCY_BASE + HIGHEST_NODE_ID) & (arrived["length"] == EMCY_BYTES)
        for frame in arrived[emcy & plain]:
            self._emergency(int(frame["can_id"]) - EMCY_BASE, int.from_bytes(frame["data"][:2].tobytes(), "little"))

    def account(self) -> None:
        """Add up the time that the frames taken so far were on the bus; cheap for many frames, not for few."""
        if not self._unaccounted:
            return
        taken = np.concatenate(self._unaccounted)
        self._unaccounted.clear()
        busy_ns = int(
            frame_time_ns(taken[taken["flags"] & ERROR == 0], self._layout.bitrate, self._layout.data_bitrate).sum()
        )
        self._busy_ns += busy_ns
        self._total_busy_ns += busy_ns

    def restart(self, since_s: float) -> None:
        """Forget the load so far and count from `since_s`, a monotonic time: when SYNC starts."""
        self._unaccounted.clear()
        self._busy_ns = self._total_busy_ns = 0
        self._since_s = self._start_s = since_s

    def started(self, node_id: int) -> None:
        """Take it that a node is OPERATIONAL from now on, until its next heartbeat says so."""
        place = self.node_ids.index(node_id)
        self._nmt[place], self._heard_s[place] = OPERATIONAL, time.monotonic()

    @property
    def nmt(self) -> npt.NDArray[np.uint8]:
        """NMT state of every node by its last heartbeat, `SILENT` when that is overdue; shape (nodes,)."""
        overdue = time.monotonic() - self._heard_s > self._silent_after_s
        return np.where(overdue, np.uint8(SILENT), self._nmt)

    def state(
        self, link: Link, missing: npt.NDArray[np.int64], late: npt.NDArray[np.int64], refused: list[int]
    ) -> BusState:
        """Return the state of the bus; the load is that since the last call.

        Parameters
        ----------
        link : Link
            The connection itself.
        missing, late : array of int, shape (nodes,)
            What the collector counted of each node's frames.
        refused : list of int
            Nodes that boot refused.
        """
        self.account()
        now_s = time.monotonic()
        elapsed_s = now_s - self._since_s
        load = self._busy_ns * 1e-9 / elapsed_s if elapsed_s > 0 else 0.0
        self._busy_ns, self._since_s = 0, now_s
        return BusState(
            name=self._layout.name,
            load_ratio=load,
            nodes=self.node_ids,
            nmt=self.nmt.tobytes(),
            missing=missing.tolist(),
            late=late.tolist(),
            emcy=list(self._emcy),
            refused=refused,
            link=link.state.name.lower(),
            overrun=link.dropped,
        )

    @property
    def mean_load_ratio(self) -> float:
        """Load since SYNC started."""
        elapsed_s = time.monotonic() - self._start_s
        return self._total_busy_ns * 1e-9 / elapsed_s if elapsed_s > 0 else 0.0

    def _emergency(self, node_id: int, code: int) -> None:
        if node_id not in self.node_ids:
            return
        self._emcy[self.node_ids.index(node_id)] = code
        if code:
            self.emergencies.append((node_id, code))

    def _beat(self, node_id: int, state: int) -> None:
        if node_id not in self.node_ids:
            return
        place = self.node_ids.index(node_id)
        self._nmt[place] = state
        self._heard_s[place] = time.monotonic()
        if state == 0:
            self.booted.add(node_id)
