"""One virtual board: where it sits on the skin, its LSS slave, and the node that its node-ID makes it."""

from pathlib import Path

from dbc.canopen import LSS_RESPONSE_COB_ID, NO_NODE_ID, NmtCommand, NmtState
from dbc.contract import Contract, NodeContract
from dbc.dictionary import REVISION, serial_number
from dbc.frame import one_frame
from nodes.hardware import Hardware
from nodes.lss import LssSlave
from nodes.node import SkinNode
from nodes.node_objects import NodeObjects
from nodes.objects import Outbox
from nodes.sending import sending_of
from nodes.storage import Storage


class VirtualBoard:
    """A board in Python.

    Parameters
    ----------
    site : NodeContract
        The node of the layout on whose place the board sits.
    hardware, store, unnumbered
        As for `nodes.virtual_boards.VirtualBoards`.
    outbox : Outbox
        Where the board sends.

    Attributes
    ----------
    slave : LssSlave
    node : SkinNode
        The node of the newest node-ID.
    """

    def __init__(
        self,
        contract: Contract,
        site: NodeContract,
        hardware: Hardware,
        outbox: Outbox,
        *,
        store: Path | None = None,
        unnumbered: bool = False,
    ) -> None:
        self._contract, self._site, self._hardware, self._outbox = contract, site, hardware, outbox
        self._storage = Storage.of_node(contract, site, store)
        self._serial = serial_number(contract, site)
        self._on_bus = {each.node_id: each for each in contract.on_bus(site.bus)}
        layout, stored = contract.layout, self._storage.node_id
        known = [
            each.node_id
            for each in self._on_bus.values()
            if each is site or ((each.blocks, each.sums) == (site.blocks, site.sums) and not layout.taxels.is_analogue)
        ]
        if stored == NO_NODE_ID and not unnumbered:
            stored = site.node_id
        self.slave = LssSlave(
            (layout.device.vendor_id, layout.device.product_code, REVISION, self._serial),
            known,
            layout.bus[site.bus].bitrate,
            self._storage.save_node_id,
            stored=stored if stored in known else NO_NODE_ID,
        )
        self.node = self._new_node(site)

    def power_up(self, now_s: float) -> None:
        """Boot with the node-ID that is stored or set by switches."""
        self.slave.reset()
        self._boot(now_s)

    def command(self, command: int, now_s: float) -> None:
        """Execute an NMT command."""
        if command == NmtCommand.RESET_NODE:
            self.power_up(now_s)
        elif command == NmtCommand.RESET_COMMUNICATION:
            self.slave.initialise()
            self._boot(now_s, communication_only=True)
        else:
            self.node.command(command)

    def take_lss(self, data: bytes, now_s: float) -> bool:
        """Answer a request of LSS; tell whether the board has booted with its first node-ID."""
        answer = self.slave.take(data)
        if answer is not None:
            response = one_frame(LSS_RESPONSE_COB_ID, answer)
            response["port"] = self.node.contract.node_id
            self._outbox.post(response)
        if not self.slave.is_due:
            return False
        self.slave.initialise()
        self._boot(now_s)
        return True

    def _boot(self, now_s: float, *, communication_only: bool = False) -> None:
        """Initialise with the present node-ID; without one, the node is silent."""
        node_id = self.slave.node_id
        if node_id == NO_NODE_ID:
            self.node.end()
            return
        if node_id != self.node.contract.node_id:
            self._become(self._on_bus[node_id])
            communication_only = False
        self.node.boot(now_s, communication_only=communication_only)

    def _become(self, node: NodeContract) -> None:
        """Take the constants of another node; the board stays where it is."""
        if self.node.state is not NmtState.INITIALISING:
            self.node.end()
        for place in range(node.blocks):
            self._hardware.place(node.block + place, self._site.block + place)
        self.node = self._new_node(node)

    def _new_node(self, node: NodeContract) -> SkinNode:
        objects = NodeObjects(
            self._contract, node, hardware=self._hardware, storage=self._storage, serial_number=self._serial
        )
        return sending_of(self._contract.layout).node(node, objects, self._outbox, self._hardware)
