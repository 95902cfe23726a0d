"""Commissioning of the boards of one bus: LSS (CiA 305) gives the node-IDs, SDO the configuration."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Final, cast

from bus.link import Send
from commissioning.lss_steps import (
    RESET_S,
    SELECTED_S,
    TWO_SERIALS,
    Address,
    Answer,
    Ask,
    LssSteps,
    Step,
    Steps,
    Talk,
    Talked,
    TroubleError,
)
from commissioning.node_check import LISTEN_PERIODS, LISTEN_S
from dbc import indices as od
from dbc.canopen import (
    HEARTBEAT_BASE,
    LSS_BIT_RATES_HZ,
    LSS_REQUEST_COB_ID,
    NMT_COB_ID,
    NO_NODE_ID,
    Lss,
    NmtCommand,
)
from dbc.configuration import Setting, configuration, expected_signature
from dbc.contract import Contract, NodeContract
from dbc.dictionary import serial_number
from dbc.lss import lss_request
from gateway.proof import Known, Proof, prove
from gateway.sdo import Dialogue, Read, SdoAbortedError, Write

#: What `skin commission` says of a board that needs another node-ID.
OTHER_HINT: Final = ": --renumber gives it the right one"
_NOT_FOUND: Final = "not found: is the board powered, on this bus, at this bit rate, with LSS?"


@dataclass
class Board:
    """A board of the contract, and how far it has come.

    Attributes
    ----------
    serial : int
        Serial number (1018h:4) of the contract.
    is_complete : bool
        The board has its node-ID, and the configuration of the contract.
    done : str
        What has been done, in words.
    trouble : str
        Why the board is not complete; empty where nothing went wrong.
    """

    node: NodeContract
    serial: int
    is_complete: bool = False
    done: str = ""
    trouble: str = ""

    @property
    def is_begun(self) -> bool:
        """Whether the board was found, or something went wrong."""
        return bool(self.done or self.trouble)

    @property
    def text(self) -> str:
        """State of the board in words."""
        if self.trouble:
            return f"{self.trouble}{f' (so far: {self.done})' if self.done else ''}"
        return self.done or "not looked for: the run ended before"


class Commissioning(LssSteps):
    """What every way to commission the boards of one bus does.

    Parameters
    ----------
    bus : int
        Number of the bus in the layout.
    bit_rate_hz : int, optional
        Bit rate of the link, where it is not that of the layout: boards get node-ID and bit rate, and have to be
        powered again.
    renumber : bool
        Whether boards get another node-ID than they have.

    Attributes
    ----------
    boards : dict of int to Board
        By node-ID.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        send: Send,
        now_s: float,
        *,
        bit_rate_hz: int | None = None,
        renumber: bool = False,
    ) -> None:
        line = contract.layout.bus[bus]
        self._contract, self._renumber = contract, renumber
        self._bit_rate_hz = line.bitrate
        self._changes_rate = bit_rate_hz not in (None, line.bitrate)
        self.boards = {node.node_id: Board(node, serial_number(contract, node)) for node in contract.on_bus(bus)}
        self._serials = {serial_number(contract, node): node for node in contract.nodes}
        #: The board that is worked on.
        self._current: Board | None = None
        super().__init__(send, now_s)

    @property
    def is_whole(self) -> bool:
        """Whether every board is complete, and no stranger was found."""
        return all(board.is_complete for board in self.boards.values()) and not self.strangers

    def tick(self, now_s: float) -> None:
        """Do what is due."""
        was_done = self.done
        super().tick(now_s)
        if self.done and not was_done:
            for board in self.boards.values():
                if not (board.is_begun or self._has_sync):
                    board.trouble = _NOT_FOUND

    def give_up(self) -> None:
        """End at once; no board stays in the state LSS configuration, and the board in work is named."""
        super().give_up()
        if self._current is not None:
            self._current.trouble = "stopped in the middle: run skin commission again"

    def _is_alone(self) -> Generator[Step, Answer, bool]:
        """Listen for another master; let all boards leave LSS configuration if there is none."""
        yield Ask(0, b"", wait_s=max(LISTEN_S, LISTEN_PERIODS * self._contract.layout.sync.period_s))
        if self._has_sync:
            self.strangers.append("another program sends SYNC on this bus: stop the gateway, then commission again")
            return False
        yield from self._all_waiting()
        return True

    def _numbered(self) -> Generator[Step, Answer, dict[int, tuple[Talked, Address]]]:
        """Return the addresses of the boards that answer to node-IDs of the layout, by node-ID."""
        came = yield Talk({node_id: read_identity() for node_id in self.boards}, attempts=1)
        return {
            node_id: (talked, cast("Address", talked.dialogue.result))
            for node_id, talked in cast("dict[int, Talked]", came).items()
            if talked.dialogue.error is None
        }

    def _guarded(self, board: Board, steps: Steps) -> Steps:
        """Work on one board; its trouble ends its own steps alone."""
        self._current = board
        try:
            yield from steps
        except TroubleError as trouble:
            board.trouble = str(trouble)
        yield from self._all_waiting()
        self._current = None

    def _with_number(self, board: Board, talked: Talked, address: Address) -> Steps:
        """Finish a board that has its node-ID: an earlier run may have been stopped before the end."""
        _require_one(talked, board)
        vendor, product, _, serial = address
        device = self._contract.layout.device
        if (vendor, product) != (device.vendor_id, device.product_code):
            raise TroubleError(
                f"has vendor-ID {vendor:X}h, product code {product:X}h: not a board of this skin, which has"
                f" {device.vendor_id:X}h, {device.product_code:X}h"
            )
        owner = self._serials.get(serial)
        if owner is not None and owner != board.node:
            if self._renumber and (yield from self._select(address)):
                yield from self._take_node_id(board.node.node_id)
                return
            raise TroubleError(f"has serial number {serial}, that of {self._place(owner)}{OTHER_HINT}")
        board.done = f"has its node-ID, serial number {serial}"
        if (yield from self._select(address)):
            yield from self._bit_timing()
            yield from self._store()
            yield from self._all_waiting()
        yield from self._set_up(board)

    def _take_node_id(self, old: int) -> Steps:
        """Make the selected board with node-ID `old` a board without one."""
        yield from self._configure(Lss.NODE_ID, NO_NODE_ID, what="to have no node-ID")
        yield from self._store()
        yield from self._all_waiting()
        yield Ask(NMT_COB_ID, bytes((NmtCommand.RESET_COMMUNICATION, old)), wait_s=RESET_S)

    def _give(self, board: Board) -> Steps:
        """Give the selected board its node-ID and bit rate, let it boot, and set it up."""
        node_id = board.node.node_id
        board.done = "found"
        yield from self._configure(Lss.NODE_ID, node_id, what=f"node-ID {node_id}")
        board.done = f"has node-ID {node_id} until its power is cut"
        yield from self._bit_timing()
        yield from self._store()
        board.done = "has stored its node-ID"
        booted = yield Ask(
            LSS_REQUEST_COB_ID, lss_request(Lss.SWITCH_GLOBAL), b"\0", SELECTED_S, HEARTBEAT_BASE + node_id
        )
        if not booted:
            raise TroubleError("sends no boot-up message")
        if len(booted) > 1:
            raise TroubleError(TWO_SERIALS)
        yield from self._set_up(board)

    def _set_up(self, board: Board) -> Steps:
        """Write, verify and store the configuration."""
        if self._changes_rate:
            board.done += f", and {self._bit_rate_hz} bit/s from its next power-up on"
            return
        settings = configuration(self._contract, board.node)
        came = yield Talk({board.node.node_id: _prove_and_store(settings)})
        (talked,) = cast("dict[int, Talked]", came).values()
        _require_one(talked, board)
        if talked.dialogue.error is not None:
            raise TroubleError(f"is not configured: {talked.dialogue.error}")
        proof = cast("Proof", talked.dialogue.result)
        if proof.refusal:
            raise TroubleError(f"has another configuration: {proof.refusal}")
        board.is_complete = True
        board.done = f"complete{f', was written: {proof.written}' if proof.written else ''}"

    def _bit_timing(self) -> Steps:
        """Give the bit rate of the layout; CANopenNode drops the request where it knows one bit rate."""
        if self._changes_rate:
            index = LSS_BIT_RATES_HZ.index(self._bit_rate_hz)
            yield from self._configure(Lss.BIT_TIMING, 0, index, what=f"{self._bit_rate_hz} bit/s")

    def _store(self) -> Steps:
        yield from self._configure(Lss.STORE, what="the storage of its node-ID")

    def _place(self, node: NodeContract) -> str:
        return f"{self._contract.layout.bus[node.bus].name}, node {node.node_id} (block {node.block})"


def _require_one(talked: Talked, board: Board) -> None:
    if talked.answered > talked.asked:
        raise TroubleError(f"two boards answer: they have node-ID {board.node.node_id}")


def read_identity() -> Dialogue:
    """Read the address of a node (1018h); 0 for what a device does not have."""
    address = []
    for subindex in range(1, 5):
        try:
            address.append(int.from_bytes((yield Read(od.IDENTITY, subindex, od.UNSIGNED32)), "little"))
        except SdoAbortedError:
            address.append(0)
    return tuple(address)


def _prove_and_store(settings: Sequence[Setting]) -> Dialogue:
    """Compare the configuration, write what differs, and store what was written (1010h)."""
    no_gains = Known(())
    proof = yield from prove(
        settings, expected_signature(settings), no_gains, write=True, in_use=False, doubt=lambda _reason: None
    )
    if proof.written and not proof.refusal:
        yield Write(od.STORE, 1, od.SIGNATURE_SAVE.to_bytes(4, "little"))
    return proof
