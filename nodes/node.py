"""One CANopen node: its dictionary, its NMT state machine (CiA 301, 7.3.2) and its heartbeat."""

import struct
from enum import IntEnum
from typing import Final

from dbc.contract import HEARTBEAT_BASE, NodeContract
from dbc.dictionary import Object
from dbc.indices import OD_HEARTBEAT_MS, OD_MANUFACTURER, OD_TPDO_COMMUNICATION, OD_TPDO_MAPPING
from nodes.network import SegmentNetwork
from nodes.objects import LocalNode, object_dictionary


class NmtState(IntEnum):
    """NMT states as the heartbeat reports them (CiA 301, 7.2.8.3.2)."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """NMT command specifiers (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


_COMMANDED: Final = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


class SkinNode:
    """A virtual SBHE block on the bus."""

    def __init__(self, made: NodeContract, objects: list[Object], network: SegmentNetwork) -> None:
        self.contract = made
        self.state = NmtState.INITIALISING
        #: Set when a PDO record was written, until the burst is compiled anew.
        self.pdo_changed = True
        self._network = network
        self._heartbeat_at_s = float("inf")
        self.local = LocalNode(made.node_id, object_dictionary(objects))
        self.local.add_write_callback(self._written)
        network[made.node_id] = self.local

    @property
    def answers_sdo(self) -> bool:
        """Whether the SDO server works in this state."""
        return self.state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)

    def boot(self, now_s: float, *, keep_application: bool = False) -> None:
        """Run through initialisation: restore values, send the boot-up message, be PRE-OPERATIONAL."""
        self.state = NmtState.INITIALISING
        store = self.local.data_store
        for index in [each for each in store if not keep_application or each < OD_MANUFACTURER]:
            del store[index]
        self.pdo_changed = True
        self._send_state()
        self.state = NmtState.PRE_OPERATIONAL
        self._schedule_heartbeat(now_s)

    def command(self, command: int, now_s: float) -> None:
        """Obey an NMT command; unknown ones are ignored."""
        if command == NmtCommand.RESET_NODE:
            self.boot(now_s)
        elif command == NmtCommand.RESET_COMMUNICATION:
            self.boot(now_s, keep_application=True)
        elif command in _COMMANDED:
            self.state = _COMMANDED[NmtCommand(command)]

    def beat(self, now_s: float) -> None:
        """Send the heartbeat when it is due."""
        if now_s >= self._heartbeat_at_s:
            self._send_state()
            self._schedule_heartbeat(now_s)

    def value(self, index: int, subindex: int = 0) -> int:
        """Return the present value of an unsigned object."""
        return int.from_bytes(self.local.get_data(index, subindex), "little")

    def _schedule_heartbeat(self, now_s: float) -> None:
        period_s = self.value(OD_HEARTBEAT_MS) / 1000
        self._heartbeat_at_s = now_s + period_s if period_s else float("inf")

    def _send_state(self) -> None:
        cob_id = HEARTBEAT_BASE + self.contract.node_id
        self._network.send_message(cob_id, struct.pack("B", self.state))

    def _written(self, *, index: int, **_: object) -> None:
        if OD_TPDO_COMMUNICATION <= index < OD_TPDO_MAPPING + 0x200:
            self.pdo_changed = True
        elif index == OD_HEARTBEAT_MS:
            self._heartbeat_at_s = 0.0
