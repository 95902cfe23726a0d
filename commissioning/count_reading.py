"""The counts of all taxels (2012h), read from the boards of a skin by SDO, one round after another.

Each round begins with a SYNC: boards that sample at SYNC then hold the counts of one moment until the next round.
Boards with a clock of their own tell their newest sample: each count has the time of its answer, and is interpolated to
the SYNCs. The boards are PRE-OPERATIONAL, so that they send no sums.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from bus.link import Send
from canskin.errors import InputError, RunError
from commissioning.node_check import LISTEN_PERIODS, LISTEN_S
from commissioning.wiring_findings import MOMENTS
from dbc import indices as od
from dbc.canopen import NMT_COB_ID, SDO_RESPONSE_BASE, SYNC_COB_ID, NmtCommand, is_of_node
from dbc.configuration import DIALOGUES
from dbc.contract import Contract, NodeContract, sync_frame
from dbc.frame import Frames, one_frame, received
from gateway.sdo import Dialogue, Read, SdoDialogue
from skin.surface import Floats
from skin.sync_counter import next_counter

#: Rounds without touch that are needed to know the noise.
LEAST_REST: Final = 10
#: Shortest time between a SYNC and the first request for what was sampled: that of a board to read its taxels.
SAMPLED_S: Final = 0.002


class CountReading:
    """Reads the counts of all boards; frames in, frames out, time as an argument.

    Parameters
    ----------
    sends : mapping of int to callable
        Sends frames, by number of the bus.
    rest_s : float
        Time without touch at the begin.
    stroke_s : float
        Time of the stroke, which follows.
    say : callable
        Takes a line for the person who strokes.

    Attributes
    ----------
    done : bool
    due_s : float
        When `tick` has something to do; an answer that came may change that.
    rest : int
        Number of rounds without touch.
    """

    def __init__(
        self,
        contract: Contract,
        sends: Mapping[int, Send],
        now_s: float,
        *,
        rest_s: float,
        stroke_s: float,
        say: Callable[[str], None],
    ) -> None:
        self.done = False
        self.due_s = now_s + max(LISTEN_S, LISTEN_PERIODS * contract.layout.sync.period_s)
        self.rest = 0
        self._contract, self._sends, self._say = contract, sends, say
        #: Boards that sample at SYNC need not take one sooner.
        self._least_s = 0.0 if contract.layout.sending == "steps" else contract.layout.sync.period_s
        self._rest_s, self._stroke_s, self._until_s = rest_s, stroke_s, math.inf
        self._is_wired = contract.phi.taxels_of_blocks < contract.phi.taxels
        self._counter, self._now_s = 0, now_s
        self._waiting: dict[int, list[NodeContract]] = {bus: [] for bus in sends}
        self._open: dict[int, dict[int, SdoDialogue]] = {bus: {} for bus in sends}
        self._foreign = ""
        #: Of each round: time of the SYNC, counts, and times of the answers.
        self._times_s: list[float] = []
        self._counts: list[Floats] = []
        self._answered_s: list[Floats] = []

    def take(self, bus: int, arrived: Frames, now_s: float) -> None:
        """Use received frames of a bus."""
        self._now_s = now_s
        arrived = received(arrived)
        if (arrived["can_id"] == SYNC_COB_ID).any():
            self._foreign = self._contract.layout.bus[bus].name
        for each in arrived[is_of_node(arrived["can_id"], SDO_RESPONSE_BASE)]:
            dialogue = self._open[bus].get(int(each["can_id"]) - SDO_RESPONSE_BASE)
            if dialogue is not None:
                dialogue.take(each["data"][: each["length"]].tobytes(), now_s)

    def tick(self, now_s: float) -> None:
        """Do what is due.

        Raises
        ------
        InputError
            If the readings come too slowly for `stroke_s`, or another program sends SYNC.
        RunError
            If a board does not tell its counts.
        """
        self._now_s = now_s
        if self._foreign:
            raise InputError(f"{self._foreign}: another program sends SYNC: stop the gateway, then check again")
        is_asking = sum(self._ask(bus, now_s) for bus in self._sends)  # no bus waits for another
        if is_asking or now_s < self.due_s:
            return
        if self._times_s:
            self.due_s = self._times_s[-1] + self._least_s
            if now_s < self.due_s:
                return
            self._end_round(now_s)
        if not self.done:
            self._begin_round(now_s)

    def stop(self) -> None:
        """End the stroke with the present round."""
        self._until_s = -math.inf

    def readings(self) -> tuple[Floats, Floats]:
        """Return the times of the rounds, seconds since the first, and counts, shape (rounds, blocks, block_size)."""
        times_s, counts = np.array(self._times_s), np.array(self._counts)
        if self._contract.layout.sending == "steps":
            answered_s = np.array(self._answered_s)
            for place in zip(*np.nonzero(self._is_wired), strict=True):
                at = (slice(None), *place)
                counts[at] = np.interp(times_s, answered_s[at], counts[at])
        return times_s - times_s[:1], counts

    def _begin_round(self, now_s: float) -> None:
        self._counter = next_counter(self._counter)
        for bus, send in self._sends.items():
            if not self._times_s:
                for node in self._contract.on_bus(bus):  # node-ID 0 would stop other devices on the bus
                    send(one_frame(NMT_COB_ID, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, node.node_id))))
            send(sync_frame(self._counter))
            self._waiting[bus] = list(self._contract.on_bus(bus))
        self._times_s.append(now_s)
        self._counts.append(np.zeros(self._is_wired.shape))
        self._answered_s.append(np.zeros(self._is_wired.shape))
        self.due_s = now_s + SAMPLED_S

    def _ask(self, bus: int, now_s: float) -> bool:
        """Go on with the dialogues of a bus, and begin others; tell whether the round still needs them."""
        waiting, dialogues = self._waiting[bus], self._open[bus]
        for node_id, dialogue in list(dialogues.items()):
            dialogue.tick(now_s)
            if dialogue.error is not None:
                name = self._contract.layout.bus[bus].name
                raise RunError(f"{name}, node {node_id}: {dialogue.error}: the check needs its counts")
            if dialogue.done:
                del dialogues[node_id]

        def send(can_id: int, data: bytes) -> None:
            self._sends[bus](one_frame(can_id, data))

        while waiting and len(dialogues) < DIALOGUES and now_s >= self.due_s:
            node = waiting.pop()
            dialogues[node.node_id] = SdoDialogue(node.node_id, self._read(node), send, now_s)
        return bool(waiting or dialogues)

    def _read(self, node: NodeContract) -> Dialogue:
        """Read the counts of all taxels of a node."""
        for place in range(node.blocks):
            block = node.block + place
            for at in np.flatnonzero(self._is_wired[block]).tolist():
                value = yield Read(od.of_block(od.COUNTS, place), at + 1, od.UNSIGNED16)
                self._counts[-1][block, at] = int.from_bytes(value, "little")
                self._answered_s[-1][block, at] = self._now_s
        return None

    def _end_round(self, now_s: float) -> None:
        """Go from rest to stroke, or end, when it is time."""
        rounds, passed_s = len(self._times_s), now_s - self._times_s[0]
        if not self.rest and passed_s >= self._rest_s and rounds >= LEAST_REST:
            self.rest, self._until_s = rounds, min(self._until_s, now_s + self._stroke_s)
            rate_hz = rounds / passed_s
            needed = MOMENTS * int(self._is_wired.sum())
            if needed > rate_hz * self._stroke_s:
                raise InputError(
                    f"expected --live {math.ceil(needed / rate_hz)} or more: {MOMENTS} readings of each taxel,"
                    f" {rate_hz:.1f} come in a second, got {self._stroke_s:g}"
                )
            self._say(f"{rate_hz:.1f} readings a second: now stroke all of the skin, {self._stroke_s:g} s")
        self.done = now_s >= self._until_s
