"""The boards of one bus without input and output: frames and times in, frames out."""

from collections.abc import Callable
from typing import Final

import numpy as np

from bus.link import Send
from dbc.canopen import HEARTBEAT_BASE, LAST_SYNCHRONOUS, SYNC_COB_ID, is_of_node
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from nodes.firmware.library import CompiledBoards
from nodes.hardware import Hardware
from nodes.virtual_boards import VirtualBoards

#: Resolution of heartbeats, event timers and inhibit times.
TICK_S: Final = 0.005


#: The boards of one bus, in Python or in C.
Boards = VirtualBoards | CompiledBoards


class Segment:
    """The boards of one bus.

    Parameters
    ----------
    bus : int
        Number of the bus in the layout.
    boards : Boards
        Those of this bus.
    hardware : Hardware
        Of all boards of the process.
    send : callable
        Sends frames on this bus.
    complain : callable
        Takes a line for the log that may repeat often.

    Attributes
    ----------
    frames_sent, frames_dropped : int
        TPDOs that were sent, and TPDOs that found no room or could not be sent in time.
    syncs_seen : int
    sync_at_s : float
        When the newest SYNC was read.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        boards: Boards,
        hardware: Hardware,
        send: Send,
        *,
        complain: Callable[[str], None],
    ) -> None:
        self.boards = boards
        self.frames_sent = self.frames_dropped = self.syncs_seen = 0
        self.sync_at_s = self._tick_at_s = float("-inf")
        self._name = contract.layout.bus[bus].name
        self._bus, self._hardware = bus, hardware
        self._send = send
        self._complain = complain

    def boot(self, now_s: float) -> None:
        """Boot all boards."""
        self._post(self.boards.power_up(now_s))

    def tick(self, now_s: float) -> None:
        """Sample what is due, do what is due by time, and send what is news."""
        if not self._hardware.begin(now_s, now_s - self.sync_at_s):
            return
        if now_s >= self._tick_at_s and now_s >= self.boards.due_s:
            self._tick_at_s = now_s + TICK_S
            self._post(self.boards.pass_time(now_s))
        self._post(self._hardware.news(self._bus, now_s))

    def take(self, arrived: Frames, now_s: float) -> None:
        """Handle received frames in their order, with echoes of sent frames and discarded frames."""
        sent, dropped, others = self._hardware.count(self._bus, arrived, self.boards.is_pdo)
        self.frames_sent += sent
        self.frames_dropped += dropped
        if not others:
            return
        can_id, foreign = arrived["can_id"], arrived["flags"] & (ERROR | EXTENDED | REMOTE | ECHO) == 0
        for node_id in can_id[foreign & is_of_node(can_id, HEARTBEAT_BASE)] - HEARTBEAT_BASE:
            if node_id in self.boards.node_ids:
                self._complain(f"node-ID {node_id} is on {self._name} twice")
        begin = 0
        for sync in np.flatnonzero(foreign & (can_id == SYNC_COB_ID)).tolist():
            if arrived["length"][sync] == 1 and not 1 <= arrived["data"][sync, 0] <= LAST_SYNCHRONOUS:
                continue  # no counter of CiA 301, 7.2.5.2
            self._pass(arrived[begin:sync], now_s)
            self._answer(arrived[sync : sync + 1], now_s)
            begin = sync + 1
        self._pass(arrived[begin:], now_s)

    def _pass(self, arrived: Frames, now_s: float) -> None:
        if len(arrived):
            self._post(self.boards.take(arrived, now_s))

    def _answer(self, sync: Frames, now_s: float) -> None:
        self.syncs_seen += 1
        self.sync_at_s = now_s
        counter = int(sync["data"][0, 0]) if sync["length"][0] == 1 else 0
        measured = self._hardware.at_sync(self._bus, counter, int(sync["time_ns"][0]))
        self._post(self.boards.answer(sync, now_s, measured))

    def _post(self, burst: Frames) -> None:
        """Send frames; those without room are given up."""
        if not len(burst):
            return
        accepted = self._send(burst)
        if self._hardware.counts_accepted:
            self.frames_sent += int(np.count_nonzero(self.boards.is_pdo[burst["can_id"][:accepted]]))
        if accepted < len(burst):
            refused = burst[accepted:]
            self.frames_dropped += int(np.count_nonzero(self.boards.is_pdo[refused["can_id"]]))
            self.boards.refuse(refused)
