"""One CANopen node: dictionary, NMT state machine (CiA 301, 7.3.2), heartbeats, emergencies, stored parameters."""

import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

import canopen
import numpy as np

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
from dbc.configuration import Setting, signature, with_calibration
from dbc.contract import NodeContract
from dbc.dictionary import HEARTBEATS_WATCHED, ON_COMMAND
from dbc.objects import Object
from nodes.access import check_write, is_storable, number
from nodes.emcy import EmcyProducer
from nodes.hardware import Hardware
from nodes.heartbeat import HeartbeatConsumer
from nodes.objects import LocalNode, Outbox, object_dictionary
from nodes.storage import Parameters, Storage
from nodes.tpdo import LiveTpdo, read_tpdos

#: Objects whose write is a command; a read tells that the node offers the command.
_COMMANDS: Final = (od.STORE, od.RESTORE)

#: State after a communication error, by 1029h sub 1 (CiA 301, 7.5.2.33): pre-operational, no change, stopped.
_ON_ERROR: Final = (NmtState.PRE_OPERATIONAL, None, NmtState.STOPPED)


class SkinNode:
    """A virtual CANopen node that measures one or more blocks.

    Parameters
    ----------
    objects : list of Object
        The node's object dictionary.
    settings, calibration : sequences of Setting
        The objects that the signature 2006h covers, and those that 2009h covers besides.
    outbox : Outbox
        Where the node sends.
    storage : Storage
        Parameters that 1010h stored.
    serial_number : int
        1018h:4, that of the board.

    Attributes
    ----------
    state : NmtState
    health : array of int, shape (4,)
        SYNCs received, TPDOs sent, TPDOs dropped because of the window, saturated taxels (2020h).
    tpdos : list of LiveTpdo
        The PDOs that exist now; `refresh` reads them again after a write.
    sync_counter : int
        2022h: counter of the SYNC at which the sums were sampled.
    """

    def __init__(
        self,
        contract: NodeContract,
        objects: list[Object],
        settings: Sequence[Setting],
        calibration: Sequence[Setting],
        *,
        outbox: Outbox,
        hardware: Hardware,
        storage: Storage,
        serial_number: int,
    ) -> None:
        self.contract = contract
        self.state = NmtState.INITIALISING
        self.health = np.zeros(4, np.int64)
        self.tpdos: list[LiveTpdo] = []
        self.sync_counter = 0
        self._signed = {
            od.SIGNATURE: settings,
            od.CALIBRATION_SIGNATURE: with_calibration(settings, calibration),
        }
        self._signatures: dict[int, int] = {}
        self._storage = storage
        self._outbox = outbox
        self._hardware = hardware
        self._changed = True
        self._has_events = False
        self._emcy_cob_id = 0
        self._emcy_inhibit_s = 0.0
        first = contract.block
        self._live: dict[int, Callable[[int], float | None]] = {
            od.ERROR_REGISTER: lambda _: self.emcy.register,
            od.ERROR_FIELD: self._read_error,
            od.HEALTH: self._read_health,
            od.SYNC_COUNTER: lambda _: self.sync_counter,
            od.IDENTITY: lambda subindex: serial_number if subindex == 4 else None,
            **{index: partial(self._read_signature, index) for index in self._signed},
            od.TEMPERATURE: lambda _: round(10 * hardware.temperature_k(range(first, first + contract.blocks))),
            **{
                od.of_block(index, place): partial(read, contract.block + place)
                for index, read in ((od.SUMS, self._read_sum), (od.COUNTS, self._read_count))
                for place in range(contract.blocks)
            },
            **{index: lambda subindex: ON_COMMAND if subindex else None for index in _COMMANDS},
        }
        self.local = LocalNode(contract.node_id, object_dictionary(objects), contract.packing.bits, contract.pdo_bytes)
        self.local.add_write_callback(self._written)  # type: ignore[no-untyped-call]
        self.local.add_read_callback(self._read)  # type: ignore[no-untyped-call]
        self.emcy = EmcyProducer(self._send_emcy)
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
        self.local.sdo.reset()
        store = self.local.data_store
        for index in [index for index in store if index < od.MANUFACTURER or not communication_only]:
            del store[index]
        stored = self._storage.parameters if self._storage.owner == self.contract.node_id else {}
        for index, entries in stored.items():
            for subindex, data in entries.items():
                if (index < od.MANUFACTURER or not communication_only) and self._is_stored(index, subindex, data):
                    store.setdefault(index, {})[subindex] = data
        if not communication_only:
            self._reset_electronics()
        self._signatures.clear()
        self.emcy.reset()
        self.watched = HeartbeatConsumer()
        self.health[:] = 0
        self._changed = True
        self.refresh(now_s)
        self._send_state()
        self._enter(NmtState.PRE_OPERATIONAL)
        # Otherwise boards powered together would send their heartbeats together, inside a burst of sums.
        part = self.contract.node_id / (HIGHEST_NODE_ID + 1)
        self._beat_due_s = now_s + part * self._beat_period_s if self._beat_period_s else float("inf")

    def end(self) -> None:
        """Be silent until `boot`: the node has no node-ID."""
        self._enter(NmtState.INITIALISING)

    def _is_stored(self, index: int, subindex: int, data: bytes) -> bool:
        found = self.local.variable(index, subindex)
        return found is not None and found.writable and is_storable(index, found.data_type, data)

    def _reset_electronics(self) -> None:
        """Set the electronics to the dictionary's calibration and to no test pattern."""
        for place in range(self.contract.blocks):
            self._hardware.reset(self.contract.block + place)
        for index, entries in self.local.data_store.items():
            if index >= od.MANUFACTURER:
                for subindex, data in entries.items():
                    self._adjust(index, subindex, data)

    def _adjust(self, index: int, subindex: int, data: bytes) -> None:
        """Pass a value of the manufacturer's area to the electronics."""
        place, first = od.split_block(index)
        if first == od.OFFSET:
            value: float = int.from_bytes(data, "little", signed=True)
        else:
            found = self.local.variable(index, subindex)
            value = number(found.data_type if found else None, data)
        self._hardware.adjust(self.contract.block + place, first, subindex, value)

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
        if not self._changed:
            return False
        self._changed = False
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
                    self.send(tpdo, payload)

    def send(self, tpdo: LiveTpdo, payload: bytes) -> None:
        """Send one TPDO outside a burst."""
        self._outbox.send_pdo(tpdo.cob_id, payload, self.contract.flags)
        self.health[1] += 1

    @property
    def pdo_ids(self) -> list[int]:
        """The identifiers of the PDOs that exist."""
        return [tpdo.cob_id for tpdo in self.tpdos]

    def refused(self, cob_id: int) -> None:  # noqa: ARG002  all PDOs are alike
        """Take note of a PDO that found no room in the transmit queue."""
        self.health[1] -= 1

    def expired(self, count: int) -> None:
        """Count and report PDOs that could not be sent within the window (1007h)."""
        self.health[2] += count
        self.emcy.raised(Emergency.WINDOW_MISSED, int(self.health[2]))

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

    def _read(self, *, index: int, subindex: int, **_: object) -> Any:
        """Return the present value of a computed object; None for stored objects."""
        reader = self._live.get(index)
        return reader(subindex) if reader else None

    def _read_error(self, subindex: int) -> int:
        history = self.emcy.history
        if subindex == 0:
            return len(history)
        if subindex > len(history):
            raise canopen.SdoAbortedError(Abort.NO_DATA)
        return history[subindex - 1]

    def _read_signature(self, index: int, _subindex: int) -> int:
        """Return the signature of the present values; test patterns are read from the electronics."""
        if index not in self._signatures:
            covered = self._signed[index]
            self._signatures[index] = signature((each.index, each.subindex, self._value(each)) for each in covered)
        return self._signatures[index]

    def _value(self, setting: Setting) -> bytes:
        place, first = od.split_block(setting.index)
        if first == od.TEST_PATTERN:
            return bytes((self._hardware.pattern(self.contract.block + place),))
        return self.local.get_data(setting.index, setting.subindex)

    def _read_health(self, subindex: int) -> int | None:
        contract = self.contract
        self.health[3] = sum(self._hardware.saturated(contract.block + place) for place in range(contract.blocks))
        return int(self.health[subindex - 1]) if subindex else None

    def _read_sum(self, block: int, subindex: int) -> int | None:
        first = self._hardware.first_sum(block) + subindex - 1
        return int(self.contract.packing.raw(self._hardware.sums[first : first + 1])[0]) if subindex else None

    def _read_count(self, block: int, subindex: int) -> int | None:
        return int(self._hardware.counts(block)[subindex - 1]) if subindex else None

    def _written(self, *, index: int, subindex: int, data: bytes, **entry: Any) -> None:
        check_write(self.local, index, subindex, number(entry["od"].data_type, data))
        if index == od.ERROR_FIELD:
            self.emcy.clear_history()
        elif index == od.STORE:
            self._store({at: dict(entries) for at, entries in self.local.data_store.items() if at not in _COMMANDS})
        elif index == od.RESTORE:
            self._store({})
        self._signatures.clear()
        if index >= od.MANUFACTURER:
            self._adjust(index, subindex, data)
        else:
            self._changed = True

    def _store(self, parameters: Parameters) -> None:
        try:
            if parameters:
                self._storage.save(parameters)
            else:
                self._storage.clear()
        except OSError as error:
            raise canopen.SdoAbortedError(Abort.HARDWARE) from error
