"""The boards of one bus without a gateway: who answers, what differs from the layout, and what else is on the bus.

Nothing is written, and no board is started or stopped.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.measured import Identifiers
from bandwidth.plan import bus_time
from bandwidth.traffic import traffic
from bus.error_frames import ErrorClass
from bus.link import DISCARDED, Link, State
from canskin.messages import SILENT, Fault, NodeFault
from dbc.canopen import (
    HEARTBEAT_BASE,
    HEARTBEAT_BYTES,
    HIGHEST_NODE_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    NmtState,
)
from dbc.configuration import DIALOGUES, configuration, expected_signature
from dbc.contract import Contract
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames, frames, one_frame
from dbc.frame_bits import frame_time_ns
from gateway.proof import Known, Proof, prove
from gateway.questions import Questions
from gateway.sdo import Dialogue, SdoDialogue
from gateway.strangers import Strangers
from health.causes import ERROR as IS_ERROR
from health.causes import INFO, WARNING, Cause
from health.nodes_why import trouble_of
from health.notices import notices_of
from health.snapshot import DEAD_LINKS, BusView, Notice

#: Longest look; the shortest lasts until each board has sent a heartbeat.
LONGEST_S: Final = 2.5
#: Part of a bus that nobody need have planned.
UNPLANNED_RATIO: Final = 0.02
_TICK_S: Final = 0.002
_OF_ERRORS: Final = ErrorClass.PROTOCOL | ErrorClass.ACK | ErrorClass.BUS_ERROR
_TROUBLES: Final = {
    State.PASSIVE: "troubled: the controller is error passive: no board acknowledges, or the bit rates differ",
    State.BUS_OFF: "dead: the controller is bus-off: wiring, termination or bit rate",
    State.LOST: "dead: the interface is lost",
}


class BusLook:
    """Looks at one bus: frames and times in, SDO uploads out; see `commissioning.talk.Talk`.

    Attributes
    ----------
    done : bool
    due_s : float
    """

    def __init__(self, contract: Contract, bus: int, link: Link, now_s: float) -> None:
        self.done, self.due_s = False, now_s
        self._contract, self._bus, self._link = contract, bus, link
        self._line, self._begin_s, self._now_s = contract.layout.bus[bus], now_s, now_s
        self._settings = {node.node_id: configuration(contract, node) for node in contract.on_bus(bus)}
        self._optional = {node.node_id for node in contract.on_bus(bus) if node.is_optional}
        self._nmt = dict.fromkeys(self._settings, SILENT)
        self._answered: set[int] = set()
        self._ended: dict[int, SdoDialogue] = {}
        self._seen: list[Frames] = [frames(0)]
        self._syncs = 0
        self._state = link.state
        self._strangers = Strangers(self._send)
        self._questions = Questions(self._prove, self._send)
        self._questions.ask(self._settings)

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames, in bus order."""
        self._state = max(self._state, self._link.state)
        seen = arrived[arrived["flags"] & DISCARDED != DISCARDED]
        self._seen.append(seen)
        plain = seen[seen["flags"] & (ERROR | REMOTE | ECHO | EXTENDED) == 0]
        self._syncs += int(np.count_nonzero(plain["can_id"] == SYNC_COB_ID))
        for each in plain[plain["can_id"] >= SDO_RESPONSE_BASE]:
            can_id, data = int(each["can_id"]), each["data"][: each["length"]].tobytes()
            base, node_id = can_id & ~HIGHEST_NODE_ID, can_id & HIGHEST_NODE_ID
            is_beat = base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES
            if node_id not in self._settings:
                self._strangers.heard(node_id) if is_beat else self._strangers.take(base, node_id, data, now_s)
                continue
            if is_beat:
                self._nmt[node_id] = data[0] & 0x7F or NmtState.PRE_OPERATIONAL
            elif base == SDO_RESPONSE_BASE:
                self._answered.add(node_id)
            self._questions.take(base, node_id, data, now_s)

    def tick(self, now_s: float) -> None:
        """Go on with the dialogues, and begin the next ones."""
        self.due_s, self._now_s = now_s + _TICK_S, now_s
        self._ended |= self._questions.tick(now_s)
        while self._questions.left and (before := self._questions.under_way) < DIALOGUES:
            self._questions.begin(now_s)
            if self._questions.under_way == before:
                break
        if self._syncs:
            self._strangers.find_producers(now_s)
        self._strangers.tick(now_s)
        took_s = now_s - self._begin_s
        self.done = took_s > LONGEST_S or (took_s > SILENT_AFTER_S and self._questions.done)

    def notices(self) -> list[Notice]:
        """Return what is wrong with the bus and its boards."""
        name, seen, took_s = self._line.name, np.concatenate(self._seen), self._now_s - self._begin_s
        faults = {node_id: fault for node_id in self._settings if (fault := self._fault(node_id)) is not None}
        away = [each for each in faults.values() if each.kind in {Fault.ABSENT, Fault.UNANSWERED}]
        link, is_passive = self._state.name.lower(), self._state is State.PASSIVE
        is_dead = self._state > State.PASSIVE or len(away) == len(self._settings)
        level = IS_ERROR if is_dead else WARNING if is_passive else INFO
        view = BusView(
            name=name,
            load_ratio=self._load(seen, took_s),
            nodes=list(self._settings),
            nmt=list(self._nmt.values()),
            link=link,
            trouble=_TROUBLES.get(self._state, ""),
            other_sync=f"{self._syncs / took_s:.0f} SYNCs a second; {self._strangers.words}" if self._syncs else "",
            dead=link in DEAD_LINKS,
            synced=False,
            nodes_why=[trouble_of(fault, self._nmt[each]).of_node(each, 0.0) for each, fault in faults.items()],
            level=level,
        )
        return [*notices_of([view]), *self._of_bus(seen, took_s)]

    def _of_bus(self, seen: Frames, took_s: float) -> list[Notice]:
        """Tell of destroyed frames, and of a load that nobody has planned."""
        name, found = self._line.name, []
        errors = int(np.count_nonzero(seen["can_id"][seen["flags"] & ERROR != 0] & _OF_ERRORS))
        if errors and self._state < State.PASSIVE:
            found.append(Cause.BUS_ERRORS.notice(f"{name}: {errors} error frames in {took_s:.1f} s", name))
        load = self._load(seen[self._is_of_others(seen)], took_s)
        most = bus_time(traffic(self._contract, self._bus), "worst").beats_s
        if load > most + UNPLANNED_RATIO and not self._syncs:
            text = f"{name}: heartbeats and other devices take {load:.1%} of the bus, planned are {most:.1%} at most"
            found.append(Cause.BUS_LOAD_ABOVE_PLAN.notice(text, name))
        return found

    def _is_of_others(self, seen: Frames) -> npt.NDArray[np.bool_]:
        """Tell which frames are neither sums, nor SDO transfers with the boards."""
        base, node_id = seen["can_id"] & ~np.uint32(HIGHEST_NODE_ID), seen["can_id"] & HIGHEST_NODE_ID
        is_sdo = np.isin(base, (SDO_REQUEST_BASE, SDO_RESPONSE_BASE)) & np.isin(node_id, [*self._settings])
        is_ours = is_sdo & (seen["flags"] & EXTENDED == 0)
        is_sums = Identifiers(self._contract, self._bus).is_sums(seen)
        found: npt.NDArray[np.bool_] = ~is_ours & ~is_sums
        return found

    def _load(self, seen: Frames, took_s: float) -> float:
        real = seen[seen["flags"] & ERROR == 0]
        time_ns = frame_time_ns(real, self._line.bitrate, self._line.data_bitrate)
        return float(time_ns.sum()) * 1e-9 / took_s

    def _fault(self, node_id: int) -> NodeFault | None:
        """Return why a board could not be used; None if it could."""
        dialogue = self._ended.get(node_id)
        if dialogue is not None and isinstance(dialogue.result, Proof):
            return self._refusal(dialogue.result)
        if node_id in self._answered and node_id not in self._questions.busy and dialogue is None:
            return NodeFault(Fault.UNPROVEN, "not all its objects were read in time")
        if dialogue is None:
            return NodeFault(Fault.UNANSWERED, "another master uses its SDO channel")
        if self._nmt[node_id] == SILENT and node_id not in self._answered:
            return NodeFault(Fault.AWAY if node_id in self._optional else Fault.ABSENT)
        return NodeFault(Fault.UNANSWERED, str(dialogue.error))

    def _refusal(self, proof: Proof) -> NodeFault | None:
        if not proof.refusal:
            return None
        if proof.can_write and self._contract.layout.configure == "write":
            return NodeFault(Fault.STARTING, f"the gateway writes at its start: {proof.refusal}")
        return NodeFault(Fault.OTHER_DEVICE if proof.is_other_device else Fault.REFUSED, proof.told(self._contract))

    def _prove(self, node_id: int) -> Dialogue:
        settings = self._settings[node_id]
        known = Known(())  # gains and offsets are those of the board
        signature = expected_signature(settings)
        return prove(settings, signature, known, write=False, in_use=False, doubt=lambda _: None)

    def _send(self, can_id: int, data: bytes) -> None:
        self._link.send(one_frame(can_id, data))
