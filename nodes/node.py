"""One CANopen node: dictionary, NMT state machine (CiA 301, 7.3.2), heartbeats, emergencies, stored parameters."""

import struct
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np

from dbc.contract import HEARTBEAT_BASE, HIGHEST_NODE_ID, NodeContract
from dbc.dictionary import HEARTBEATS_WATCHED, ON_COMMAND, Object
from dbc.indices import (
    OD_CONSUMER_HEARTBEAT,
    OD_EMCY_COB_ID,
    OD_EMCY_INHIBIT_100US,
    OD_ERROR_BEHAVIOUR,
    OD_ERROR_FIELD,
    OD_ERROR_REGISTER,
    OD_HEALTH,
    OD_HEARTBEAT_MS,
    OD_MANUFACTURER,
    OD_OFFSET,
    OD_RESTORE,
    OD_STORE,
    OD_SUMS,
    REAL32,
    of_block,
    split_block,
)
from nodes.access import PDO_INVALID, check_write
from nodes.emcy import EmcyProducer, Emergency
from nodes.heartbeat import HeartbeatConsumer, HeartbeatProducer
from nodes.network import SegmentNetwork
from nodes.nmt import COMMANDED, NmtCommand, NmtState
from nodes.objects import LocalNode, object_dictionary
from nodes.sampler import Sampler
from nodes.tpdo import EVENT_MANUFACTURER, Tpdo, read_tpdos

#: Writing these does something; reading them says that the node can do it.
_COMMANDS: Final = (OD_STORE, OD_RESTORE)

Store = dict[int, dict[int, bytes]]

#: State after a communication error, by 1029h sub 1 (CiA 301, 7.5.2.33): pre-operational, no change, stopped.
_ON_ERROR: Final = (NmtState.PRE_OPERATIONAL, None, NmtState.STOPPED)


class SkinNode:
    """A virtual SBHE block on the bus.

    Attributes
    ----------
    state : NmtState
    health : array of int, shape (4,)
        SYNCs seen, TPDOs sent, TPDOs dropped outside the window, saturated taxels (2020h).
    tpdos : list of Tpdo
        The PDOs that exist now; read anew by `refresh` after a write.
    """

    def __init__(
        self, contract: NodeContract, objects: list[Object], network: SegmentNetwork, sampler: Sampler
    ) -> None:
        self.contract = contract
        self.state = NmtState.INITIALISING
        self.health = np.zeros(4, np.int64)
        self.tpdos: list[Tpdo] = []
        self._network = network
        self._sampler = sampler
        self._saved: Store = {}
        self._changed = True
        self._has_events = False
        self._emcy_cob_id = 0
        self._emcy_inhibit_s = 0.0
        self._live: dict[int, Callable[[int], int | None]] = {
            OD_ERROR_REGISTER: lambda _: self.emcy.register,
            OD_ERROR_FIELD: self._read_error,
            OD_HEALTH: self._read_health,
            **{
                of_block(OD_SUMS, place): partial(self._read_sum, contract.block + place)
                for place in range(contract.blocks)
            },
            **{index: lambda subindex: ON_COMMAND if subindex else None for index in _COMMANDS},
        }
        self.local = LocalNode(contract.node_id, object_dictionary(objects), contract.packing.bits, contract.pdo_bytes)
        self.local.on_write(self._written)
        self.local.on_read(self._read)
        self.emcy = EmcyProducer(self._send_emcy)
        self.heartbeat = HeartbeatProducer(self._send_state)
        self.watched = HeartbeatConsumer()
        network[contract.node_id] = self.local

    @property
    def answers_sdo(self) -> bool:
        """Whether the SDO server works in this state."""
        return self.state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)

    def boot(self, now_s: float, *, communication_only: bool = False) -> None:
        """Run through initialisation: restore parameters, send the boot-up message, be PRE-OPERATIONAL."""
        self.state = NmtState.INITIALISING
        store = self.local.data_store
        for index in [index for index in store if index < OD_MANUFACTURER or not communication_only]:
            del store[index]
        for index, entries in self._saved.items():
            if index < OD_MANUFACTURER or not communication_only:
                store[index] = dict(entries)
        self.emcy.reset()
        self.health[:] = 0
        self._changed = True
        self.refresh(now_s)
        self._send_state()
        self.state = NmtState.PRE_OPERATIONAL
        # Boards that are powered together would all beat together, in the middle of a burst of sums.
        part = self.contract.node_id / (HIGHEST_NODE_ID + 1)
        self.heartbeat.set_period(self.local.unsigned(OD_HEARTBEAT_MS) / 1000, now_s, part)

    def command(self, command: int, now_s: float) -> None:
        """Obey an NMT command; unknown ones are ignored."""
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self.boot(now_s, communication_only=command == NmtCommand.RESET_COMMUNICATION)
        elif command in COMMANDED:
            self.state = COMMANDED[NmtCommand(command)]

    def wants(self, now_s: float) -> bool:
        """Tell whether `tick` has anything to do: most nodes have not, most of the time."""
        waits = self._has_events or self.emcy.is_waiting
        return waits or now_s >= self.heartbeat.due_s or now_s >= self.watched.due_s

    def refresh(self, now_s: float) -> bool:
        """Read what writes have changed since the last call; tell whether anything had."""
        if not self._changed:
            return False
        self._changed = False
        local = self.local
        self.tpdos = read_tpdos(local, [tpdo.number for tpdo in self.contract.tpdos])
        self._has_events = any(tpdo.every >= EVENT_MANUFACTURER for tpdo in self.tpdos)
        self._emcy_cob_id = local.unsigned(OD_EMCY_COB_ID)
        self._emcy_inhibit_s = local.unsigned(OD_EMCY_INHIBIT_100US) * 1e-4
        self.watched.watch([local.unsigned(OD_CONSUMER_HEARTBEAT, place) for place in range(1, HEARTBEATS_WATCHED + 1)])
        self.heartbeat.set_period(local.unsigned(OD_HEARTBEAT_MS) / 1000, now_s)
        return True

    def tick(self, now_s: float) -> None:
        """Do what time alone calls for: heartbeats out and in, emergencies, event-driven PDOs."""
        self.heartbeat.beat(now_s)
        self._watch(now_s)
        if self.state is NmtState.STOPPED:
            return
        self.emcy.flush(now_s, self._emcy_inhibit_s)
        if self.state is NmtState.OPERATIONAL:
            for tpdo in self.tpdos:
                payload = tpdo.at_event(now_s, self.local)
                if payload is not None:
                    self.send(tpdo, payload)

    def send(self, tpdo: Tpdo, payload: bytes) -> None:
        """Send one TPDO outside a burst."""
        self.health[1] += self._network.send_pdo(tpdo.cob_id, payload, self.contract.flags)

    def _watch(self, now_s: float) -> None:
        before = bool(self.watched.lost)
        self.watched.check(now_s)
        lost = bool(self.watched.lost)
        if lost and not before:
            self.emcy.raised(Emergency.HEARTBEAT_LOST, min(self.watched.lost))
            state = _ON_ERROR[self.local.unsigned(OD_ERROR_BEHAVIOUR, 1)]
            if self.state is NmtState.OPERATIONAL and state is not None:
                self.state = state
        elif before and not lost:
            self.emcy.gone(Emergency.HEARTBEAT_LOST)

    def heard(self, node_id: int, now_s: float) -> None:
        """Take note of another node's heartbeat."""
        before = bool(self.watched.lost)
        self.watched.heard(node_id, now_s)
        if before and not self.watched.lost:
            self.emcy.gone(Emergency.HEARTBEAT_LOST)

    def _send_state(self) -> None:
        self._network.send_message(HEARTBEAT_BASE + self.contract.node_id, struct.pack("B", self.state))

    def _send_emcy(self, payload: bytes) -> None:
        if not self._emcy_cob_id & PDO_INVALID:
            self._network.send_message(self._emcy_cob_id & 0x7FF, payload)

    def _read(self, *, index: int, subindex: int, **_: object) -> Any:
        """Return the present value of an object that is not just stored; None for all others."""
        reader = self._live.get(index)
        return reader(subindex) if reader else None

    def _read_error(self, subindex: int) -> int:
        history = self.emcy.history
        if subindex == 0:
            return len(history)
        return history[subindex - 1] if subindex <= len(history) else 0

    def _read_health(self, subindex: int) -> int | None:
        contract = self.contract
        self.health[3] = sum(self._sampler.saturated(contract.block + place) for place in range(contract.blocks))
        return int(self.health[subindex - 1]) if subindex else None

    def _read_sum(self, block: int, subindex: int) -> int | None:
        first = self._sampler.first_sum(block) + subindex - 1
        return int(self.contract.packing.raw(self._sampler.sums[first : first + 1])[0]) if subindex else None

    def _written(self, *, index: int, subindex: int, od: Any, data: bytes) -> None:
        value = struct.unpack("<f", data)[0] if od.data_type == REAL32 else int.from_bytes(data, "little")
        check_write(self.local, index, subindex, value)
        if index == OD_ERROR_FIELD:
            self.emcy.clear_history()
        elif index == OD_STORE:
            self._saved = {at: dict(entries) for at, entries in self.local.data_store.items() if at not in _COMMANDS}
        elif index == OD_RESTORE:
            self._saved = {}
        if index >= OD_MANUFACTURER:
            place, first = split_block(index)
            if first == OD_OFFSET:
                value = int.from_bytes(data, "little", signed=True)
            self._sampler.adjust(self.contract.block + place, first, subindex, value)
        else:
            self._changed = True
