"""One CANopen node: NMT state machine (CiA 301, 7.3.2), heartbeats, emergencies, TPDOs."""

import struct
from typing import Final

import canopen

from dbc import indices as od
from dbc.canopen import (
    BASE_ID_MASK,
    COB_ID_INVALID,
    COMMANDED,
    EVENT_MANUFACTURER,
    HEARTBEAT_BASE,
    HIGHEST_NODE_ID,
    Abort,
    Emergency,
    NmtCommand,
    NmtState,
)
from dbc.contract import NodeContract
from dbc.dictionary import HEARTBEATS_WATCHED, WINDOWS_MET
from dbc.frame import Frames, one_frame
from nodes.emcy import EmcyProducer
from nodes.hardware import Hardware
from nodes.heartbeat import HeartbeatConsumer
from nodes.node_objects import NodeObjects
from nodes.objects import Outbox
from nodes.tpdo import LiveTpdo, read_tpdos

#: State after a communication error, by 1029h sub 1 (CiA 301, 7.5.2.33): pre-operational, no change, stopped.
_ON_ERROR: Final = (NmtState.PRE_OPERATIONAL, None, NmtState.STOPPED)


class SkinNode:
    """A virtual CANopen node that measures one or more blocks.

    Parameters
    ----------
    objects : NodeObjects
        The node's dictionary.
    outbox : Outbox
        Where the node sends.

    Attributes
    ----------
    state : NmtState
    health : list of four ints
        SYNCs received, TPDOs sent, TPDOs dropped, saturated taxels (2020h).
    objects : NodeObjects
        The dictionary as it is now.
    tpdos : list of LiveTpdo
        The PDOs that exist now; `refresh` reads them again after a write.
    sync_counter : int
        2022h: counter of the SYNC at which the sums were sampled.
    """

    def __init__(self, contract: NodeContract, objects: NodeObjects, outbox: Outbox, hardware: Hardware) -> None:
        self.contract = contract
        self.state = NmtState.INITIALISING
        self.health = [0] * 4
        self._met_at = WINDOWS_MET
        self.tpdos: list[LiveTpdo] = []
        self.sync_counter = 0
        self._outbox = outbox
        self._hardware = hardware
        self._has_events = False
        self._emcy_cob_id = 0
        self._emcy_inhibit_s = 0.0
        self.emcy = EmcyProducer(self._send_emcy)
        self.objects = objects
        self.objects.readers |= {
            od.ERROR_REGISTER: lambda _: self.emcy.register,
            od.ERROR_FIELD: self._read_error,
            od.HEALTH: self._read_health,
            od.SYNC_COUNTER: lambda _: self.sync_counter,
        }
        self.objects.writers[od.ERROR_FIELD] = self.emcy.clear_history
        self.local = self.objects.local
        self._beat_due_s, self._beat_period_s = float("inf"), 0.0
        self.watched = HeartbeatConsumer()
        outbox[contract.node_id] = self.local

    @property
    def answers_sdo(self) -> bool:
        """Whether the SDO server works in this state."""
        return self.state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)

    def boot(self, now_s: float, *, communication_only: bool = False) -> None:
        """Initialise: restore parameters, send the boot-up message, enter PRE-OPERATIONAL."""
        self._enter(NmtState.INITIALISING)
        self.objects.load(communication_only=communication_only)
        self.emcy.reset()
        self.watched = HeartbeatConsumer()
        self.health = [0] * 4
        self.refresh(now_s)
        self._send_state()
        self._enter(NmtState.PRE_OPERATIONAL)
        # Otherwise boards powered together would send their heartbeats together, inside a burst of sums.
        part = self.contract.node_id / (HIGHEST_NODE_ID + 1)
        self._beat_due_s = now_s + part * self._beat_period_s if self._beat_period_s else float("inf")

    def end(self) -> None:
        """Be silent until `boot`: the node has no node-ID."""
        self._enter(NmtState.INITIALISING)

    def command(self, command: int) -> None:
        """Execute an NMT command; others than those to change the state are ignored."""
        if command in COMMANDED:
            self._enter(COMMANDED[NmtCommand(command)])

    def _enter(self, state: NmtState) -> None:
        self.state = state

    @property
    def due_s(self) -> float:
        """When `tick` has work to do next, as things stand."""
        if self.state is NmtState.INITIALISING:
            return float("inf")
        if self._has_events or self.emcy.is_waiting:
            return float("-inf")
        return min(self._beat_due_s, self.watched.due_s)

    def refresh(self, now_s: float) -> bool:
        """Read the objects again if a write has changed any since the last call; tell whether one had."""
        if not self.objects.take_changed():
            return False
        local = self.local
        self.tpdos = read_tpdos(local, [tpdo.number for tpdo in self.contract.tpdos])
        self._has_events = any(tpdo.every >= EVENT_MANUFACTURER for tpdo in self.tpdos)
        self._emcy_cob_id = local.unsigned(od.EMCY_COB_ID)
        self._emcy_inhibit_s = local.unsigned(od.EMCY_INHIBIT_100US) * 1e-4
        self.watched.watch([local.unsigned(od.CONSUMER_HEARTBEAT, place) for place in range(1, HEARTBEATS_WATCHED + 1)])
        period_s = local.unsigned(od.HEARTBEAT_MS) / 1000
        if period_s != self._beat_period_s:
            self._beat_period_s = period_s
            self._beat_due_s = now_s + period_s if period_s else float("inf")
        return True

    def tick(self, now_s: float) -> None:
        """Do what is due by time: send and watch heartbeats, send emergencies and event-driven PDOs."""
        if now_s >= self._beat_due_s:
            self._send_state()
            self._beat_due_s = now_s + self._beat_period_s
        self._watch(now_s)
        if self.state is NmtState.STOPPED:
            return
        self.emcy.flush(now_s, self._emcy_inhibit_s)
        if self.state is NmtState.OPERATIONAL and self._has_events:
            for tpdo in self.tpdos:
                payload = tpdo.at_event(now_s, self.local)
                if payload is not None:
                    self._outbox.post(self.tpdo_frame(tpdo, payload))

    def tpdo_frame(self, tpdo: LiveTpdo, payload: bytes) -> Frames:
        """Return the frame of a TPDO, which counts as sent."""
        self.health[1] += 1
        frame = one_frame(tpdo.cob_id, payload, self.contract.flags)
        frame["port"] = self.contract.node_id
        return frame

    @property
    def pdo_ids(self) -> list[int]:
        """The identifiers of the PDOs that exist."""
        return [tpdo.cob_id for tpdo in self.tpdos]

    def refused(self, cob_id: int) -> None:  # noqa: ARG002  all PDOs are alike
        """Take note of a PDO that found no room in the transmit queue: it was dropped, and not sent."""
        self.health[1] -= 1
        self.health[2] += 1

    def expired(self, count: int) -> None:
        """Count and report PDOs that could not be sent within the window (1007h)."""
        self.health[2] += count
        self._met_at = self.health[0] + WINDOWS_MET
        self.emcy.raised(Emergency.WINDOW_MISSED, self.health[2])

    def count_sync(self) -> None:
        """Count a SYNC, and report that windows are met again."""
        self.health[0] += 1
        if self.health[0] >= self._met_at:
            self.emcy.gone(Emergency.WINDOW_MISSED)

    def _watch(self, now_s: float) -> None:
        before = bool(self.watched.lost)
        self.watched.check(now_s)
        lost = bool(self.watched.lost)
        if lost and not before:
            self.emcy.raised(Emergency.HEARTBEAT_LOST, min(self.watched.lost))
            state = _ON_ERROR[self.local.unsigned(od.ERROR_BEHAVIOUR, 1)]
            if self.state is NmtState.OPERATIONAL and state is not None:
                self._enter(state)
        elif not lost:  # heard again, or watched no longer
            self.emcy.gone(Emergency.HEARTBEAT_LOST)

    def heard(self, node_id: int, now_s: float) -> None:
        """Note a heartbeat of another node."""
        before = bool(self.watched.lost)
        self.watched.heard(node_id, now_s)
        if before and not self.watched.lost:
            self.emcy.gone(Emergency.HEARTBEAT_LOST)

    def _send_state(self) -> None:
        self._outbox.send_message(HEARTBEAT_BASE + self.contract.node_id, struct.pack("B", self.state))

    def _send_emcy(self, payload: bytes) -> None:
        if not self._emcy_cob_id & COB_ID_INVALID:
            self._outbox.send_message(self._emcy_cob_id & BASE_ID_MASK, payload)

    def _read_error(self, subindex: int) -> int:
        history = self.emcy.history
        if subindex == 0:
            return len(history)
        if subindex > len(history):
            raise canopen.SdoAbortedError(Abort.NO_DATA)
        return history[subindex - 1]

    def _read_health(self, subindex: int) -> int | None:
        contract = self.contract
        self.health[3] = sum(self._hardware.saturated(contract.block + place) for place in range(contract.blocks))
        return self.health[subindex - 1] if subindex else None
