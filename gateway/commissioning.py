"""Commissioning of the boards of one bus: LSS (CiA 305) gives the node-IDs, SDO the configuration.

Frames and times in, frames out. The work on the bus is a generator of steps, as in `gateway.node_check`. Several boards
answer one request, each in its own time: a step waits out `WINDOW_S`, and counts the answers. Two answers to what one
board alone may answer are two boards with one serial number, or with one node-ID. Boards whose answers are always sent
in the same bit are one board on the bus.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Final, cast

from bus.link import Send
from dbc import indices as od
from dbc.canopen import (
    FASTSCAN_ALL,
    HEARTBEAT_BASE,
    HIGHEST_NODE_ID,
    LSS_BIT_RATES_HZ,
    LSS_BYTES,
    LSS_REQUEST_COB_ID,
    LSS_RESPONSE_COB_ID,
    NMT_COB_ID,
    NO_NODE_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    Lss,
    LssError,
    NmtCommand,
)
from dbc.configuration import DIALOGUES, Setting, configuration, expected_signature
from dbc.contract import Contract, NodeContract
from dbc.dictionary import REVISION, serial_number
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames, one_frame
from gateway.node_check import LISTEN_PERIODS, LISTEN_S
from gateway.proof import Known, Proof, prove
from gateway.sdo import Dialogue, Read, SdoAbortedError, SdoDialogue, Write

#: Longest time in which a board answers a request that several boards may answer.
WINDOW_S: Final = 0.03
#: Pause after a request that nobody answers: a small board takes one request at a time.
GAP_S: Final = 0.002
#: Longest wait for a board that has been selected: it may write flash memory, or boot.
PATIENCE_S: Final = 2.0
#: Longest time in which a board resets its communication.
RESET_S: Final = 0.2

Address = tuple[int, int, int, int]


@dataclass(frozen=True)
class Ask:
    """Send a frame, and get the answers: frames with `reply_id` whose payload begins with `begins`."""

    can_id: int
    data: bytes
    begins: bytes = b""
    wait_s: float = WINDOW_S
    reply_id: int = LSS_RESPONSE_COB_ID


@dataclass(frozen=True)
class Talk:
    """Lead SDO dialogues with several nodes at once, and get a `Talked` for each."""

    dialogues: dict[int, Dialogue]
    attempts: int = 3


@dataclass
class Talked:
    """A dialogue, and the numbers of its requests and answers."""

    dialogue: SdoDialogue
    asked: int = 0
    answered: int = 0


Step = Ask | Talk
Answer = list[bytes] | dict[int, Talked]
Steps = Generator[Step, Answer, None]


class TroubleError(Exception):
    """A board cannot be commissioned."""


class RefusedError(TroubleError):
    """A board answers a request of LSS with an error code."""


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


class Commissioning:
    """Commissions the boards of one bus.

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
    strangers : list of str
        What else is on the bus, in words, and why nothing was done.
    done : bool
    due_s : float
        When `tick` has something to do.
    error_frames : int
        Error frames on the bus: boards at another bit rate cause them.
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
        self._contract, self._send, self._renumber = contract, send, renumber
        self._bit_rate_hz = line.bitrate
        self._changes_rate = bit_rate_hz not in (None, line.bitrate)
        self.boards = {node.node_id: Board(node, serial_number(contract, node)) for node in contract.on_bus(bus)}
        self._serials = {serial_number(contract, node): node for node in contract.nodes}
        self.strangers: list[str] = []
        self.done = False
        self.error_frames = 0
        self._has_sync = False
        self._now_s = now_s
        #: Dialogues that wait: the transmit queue of an interface has little room.
        self._waiting: list[tuple[int, Dialogue]] = []
        #: The board that is worked on.
        self._current: Board | None = None
        self._step: Step | None = None
        self._began_s = self._ends_s = now_s
        self._answers: list[bytes] = []
        self._talked: dict[int, Talked] = {}
        self._steps = self._commission()
        self._begin(next(self._steps), now_s)

    @property
    def is_whole(self) -> bool:
        """Whether every board is complete, and no stranger was found."""
        return all(board.is_complete for board in self.boards.values()) and not self.strangers

    # Frames and time

    @property
    def due_s(self) -> float:
        """When the open step ends, as things stand; that of dialogues is not known."""
        return float("inf") if self._talked else self._ends_s

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames."""
        self.error_frames += int((arrived["flags"] & (ERROR | ECHO) == ERROR).sum())
        for each in arrived[arrived["flags"] & (ERROR | REMOTE | EXTENDED | ECHO) == 0]:
            can_id, data = int(each["can_id"]), each["data"][: each["length"]].tobytes()
            self._has_sync |= can_id == SYNC_COB_ID
            if isinstance(self._step, Ask):
                is_whole = can_id != LSS_RESPONSE_COB_ID or len(data) == LSS_BYTES
                if can_id == self._step.reply_id and is_whole and data.startswith(self._step.begins):
                    self._answers.append(data)
                    self._ends_s = min(self._ends_s, max(now_s, self._began_s + WINDOW_S))
            elif can_id & ~HIGHEST_NODE_ID == SDO_RESPONSE_BASE and can_id & HIGHEST_NODE_ID in self._talked:
                talked = self._talked[can_id & HIGHEST_NODE_ID]
                talked.answered += 1
                talked.dialogue.take(data, now_s)

    def tick(self, now_s: float) -> None:
        """Do what is due."""
        self._now_s = now_s
        if self.done:
            return
        for each in self._talked.values():
            each.dialogue.tick(now_s)
        if isinstance(self._step, Talk):
            self._open_dialogues(self._step, now_s)
            if not all(each.dialogue.done for each in self._talked.values()):
                return
        elif now_s < self._ends_s:
            return
        came: Answer = self._talked if isinstance(self._step, Talk) else self._answers
        try:
            step = self._steps.send(came)
        except StopIteration:
            self.done = True
            for board in self.boards.values():
                if not (board.is_begun or self._has_sync):
                    board.trouble = _NOT_FOUND
        else:
            self._begin(step, now_s)

    def give_up(self) -> None:
        """End at once; no board stays in the state LSS configuration, and the board in work is named."""
        self._steps.close()
        self.done = True
        if self._current is not None:
            self._current.trouble = "stopped in the middle: run skin commission again"
        self._send_one(LSS_REQUEST_COB_ID, lss_request(Lss.SWITCH_GLOBAL))

    def _begin(self, step: Step, now_s: float) -> None:
        self._step, self._began_s, self._answers, self._talked = step, now_s, [], {}
        if isinstance(step, Ask):
            self._ends_s = now_s + step.wait_s
            if step.can_id or step.data:
                self._send_one(step.can_id, step.data)
            return
        self._waiting = [*step.dialogues.items()]
        self._open_dialogues(step, now_s)

    def _open_dialogues(self, step: Talk, now_s: float) -> None:
        """Begin the dialogues that wait, up to `DIALOGUES` at once."""
        free = DIALOGUES - sum(not each.dialogue.done for each in self._talked.values())
        for node_id, steps in self._waiting[:free]:
            dialogue = SdoDialogue(node_id, steps, self._send_one, now_s, attempts=step.attempts)
            self._talked[node_id] = Talked(dialogue, asked=1)
        del self._waiting[:free]

    def _send_one(self, can_id: int, data: bytes) -> None:
        node_id = can_id - SDO_REQUEST_BASE
        if node_id in self._talked:
            self._talked[node_id].asked += 1
        self._send(one_frame(can_id, data))

    # What is done

    def _commission(self) -> Steps:
        if not (yield from self._is_alone()):
            return
        for node_id, (talked, address) in (yield from self._numbered()).items():
            yield from self._guarded(self.boards[node_id], self._with_number(self.boards[node_id], talked, address))
        for board in self.boards.values():
            if not board.is_begun:
                yield from self._guarded(board, self._fresh(board))
        yield from self._others()

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
            raise TroubleError(f"has serial number {serial}, that of {self._place(owner)}{_HINT}")
        board.done = f"has its node-ID, serial number {serial}"
        if (yield from self._select(address)):
            yield from self._bit_timing()
            yield from self._store()
            yield from self._all_waiting()
        yield from self._set_up(board)

    def _fresh(self, board: Board) -> Steps:
        """Look for a board by its address, and commission it."""
        device = self._contract.layout.device
        address = device.vendor_id, device.product_code, REVISION, board.serial
        if (yield from self._select(address)):
            old = (yield from self._configure(Lss.INQUIRE_NODE_ID))[1]
            if old not in (board.node.node_id, NO_NODE_ID):
                board.done = f"has node-ID {old}"
                if not self._renumber:
                    raise TroubleError(f"has another node-ID{_HINT}")
                yield from self._take_node_id(old)
                yield from self._selected(board, address)
            else:
                yield from self._give(board)

    def _take_node_id(self, old: int) -> Steps:
        """Make the selected board with node-ID `old` a board without one."""
        yield from self._configure(Lss.NODE_ID, NO_NODE_ID, what="to have no node-ID")
        yield from self._store()
        yield from self._all_waiting()
        yield Ask(NMT_COB_ID, bytes((NmtCommand.RESET_COMMUNICATION, old)), wait_s=RESET_S)

    def _others(self) -> Steps:
        """Find the boards without node-ID that are left: of another revision, or strangers."""
        found: dict[Address, int] = {}
        if (yield scan(0, FASTSCAN_ALL, 0, 0)):
            yield from self._fastscan((), found)
            if not found:
                self.strangers.append("boards without node-ID answer, but the fastscan finds none: run it again")
        device = self._contract.layout.device
        for address, count in found.items():
            vendor, product, revision, serial = address
            owner = self._serials.get(serial)
            board = self.boards.get(owner.node_id) if owner else None
            name = f"a board without node-ID, vendor-ID {vendor:X}h, product code {product:X}h, serial number {serial}"
            if (vendor, product) != (device.vendor_id, device.product_code) or owner is None:
                self.strangers.append(f"{name}: not a board of this skin")
            elif board is None or board.node != owner:
                self.strangers.append(f"{name}: its place is {self._place(owner)}, on another bus")
            elif board.is_begun:
                if not board.trouble and not (yield from self._is_numbered(board, address)):
                    self.strangers.append(f"{name}: {self._place(owner)} has this serial number already")
            elif count > 1:
                board.trouble = TWO_SERIALS
            else:
                board.done = f"found, revision {revision:X}h"
                yield from self._guarded(board, self._selected(board, address))

    def _is_numbered(self, board: Board, address: Address) -> Generator[Step, Answer, bool]:
        """Tell whether one board has the address, with its node-ID: Lely answers the fastscan then, too."""
        found = NO_NODE_ID
        try:
            if (yield from self._select(address)):
                found = (yield from self._configure(Lss.INQUIRE_NODE_ID))[1]
        except TroubleError:  # two boards answer
            pass
        yield from self._all_waiting()
        return found == board.node.node_id

    def _selected(self, board: Board, address: Address) -> Steps:
        if not (yield from self._select(address)):
            raise TroubleError("no longer answers")
        yield from self._give(board)

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
            LSS_REQUEST_COB_ID, lss_request(Lss.SWITCH_GLOBAL), b"\0", PATIENCE_S, HEARTBEAT_BASE + node_id
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

    # Requests of LSS

    def _all_waiting(self) -> Steps:
        yield Ask(LSS_REQUEST_COB_ID, lss_request(Lss.SWITCH_GLOBAL), wait_s=GAP_S)

    def _select(self, address: Address) -> Generator[Step, Answer, bool]:
        """Switch the board at an address to configuration; tell whether there is one."""
        *first, last = (
            lss_request(Lss.SWITCH_SELECTIVE + place, *number.to_bytes(4, "little"))
            for place, number in enumerate(address)
        )
        for each in first:
            yield Ask(LSS_REQUEST_COB_ID, each, wait_s=GAP_S)
        came = yield Ask(LSS_REQUEST_COB_ID, last, bytes((Lss.SELECTED,)))
        if len(came) > 1:
            raise TroubleError(TWO_SERIALS)
        return bool(came)

    def _configure(self, command: Lss, *values: int, what: str = "a request") -> Generator[Step, Answer, bytes]:
        """Ask the selected board, and return its answer; no answer, two, or an error code is trouble."""
        came = cast(
            "list[bytes]",
            (yield Ask(LSS_REQUEST_COB_ID, lss_request(command, *values), bytes((command,)), PATIENCE_S)),
        )
        if not came:
            raise TroubleError(f"stopped answering at {what}")
        if len(came) > 1:
            raise TroubleError(TWO_SERIALS)
        if command != Lss.INQUIRE_NODE_ID and came[0][1]:
            why = "not supported" if came[0][1] == LssError.NOT_SUPPORTED else f"error {came[0][1]}"
            raise RefusedError(f"refuses {what}: {why}")
        return came[0]

    def _fastscan(self, path: tuple[int, ...], found: dict[Address, int]) -> Steps:
        """Find the addresses that begin with the numbers `path`, of boards without node-ID, and count their boards.

        No board changes its state: in LSS configuration CANopenNode would answer every request of a fastscan.
        """
        place, begun = len(path), [(0, 32)]
        yield scan(0, FASTSCAN_ALL, 0, 0)
        for before, number in enumerate(path):
            yield scan(number, 0, before, before + 1)
        numbers: dict[int, int] = {}
        while begun:
            high, bits = begun.pop()
            for number in (high | 1 << bits - 1, high):
                count = len((yield scan(number, bits - 1, place, place)))
                if count and bits > 1:
                    begun.append((number, bits - 1))
                elif count:
                    numbers[number] = count
        for number, count in numbers.items():
            if place == 3:
                vendor, product, revision = path
                found[vendor, product, revision, number] = count
            else:
                yield from self._fastscan((*path, number), found)

    def _place(self, node: NodeContract) -> str:
        return f"{self._contract.layout.bus[node.bus].name}, node {node.node_id} (block {node.block})"


_HINT: Final = ": --renumber gives it the right one"
_NOT_FOUND: Final = "not found: is the board powered, on this bus, at this bit rate, with LSS?"
TWO_SERIALS: Final = "two boards answer: they have one serial number"


def lss_request(command: int, *values: int) -> bytes:
    """Return a request of LSS: eight bytes."""
    return bytes((command, *values)).ljust(LSS_BYTES, b"\0")


def scan(number: int, bit: int, place: int, following: int) -> Ask:
    """Ask boards without node-ID whether `number` is theirs down to `bit` (CiA 305, fastscan)."""
    data = lss_request(Lss.FASTSCAN, *number.to_bytes(4, "little"), bit, place, following)
    return Ask(LSS_REQUEST_COB_ID, data, bytes((Lss.IDENTIFIED,)))


def anybody_without_node_id() -> Frames:
    """Return the request that every board without node-ID answers."""
    return one_frame(LSS_REQUEST_COB_ID, scan(0, FASTSCAN_ALL, 0, 0).data)


def has_answer(arrived: Frames) -> bool:
    """Tell whether a board answers `anybody_without_node_id`."""
    is_answer = (arrived["can_id"] == LSS_RESPONSE_COB_ID) & (arrived["data"][:, 0] == Lss.IDENTIFIED)
    return bool((is_answer & (arrived["flags"] & (ERROR | REMOTE | EXTENDED | ECHO) == 0)).any())


def _require_one(talked: Talked, board: Board) -> None:
    if talked.answered > talked.asked:
        raise TroubleError(f"two boards answer: they have node-ID {board.node.node_id}")


def read_identity() -> Dialogue:
    """Read the address of a node (1018h); 0 for what a device does not have."""
    address = []
    for subindex in range(1, 5):
        try:
            address.append(int.from_bytes((yield Read(od.IDENTITY, subindex)), "little"))
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
