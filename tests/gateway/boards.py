"""Stepped boards that only answer SDO, NMT and send sums, with their gateway, in one thread on wires of arrays."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from canskin.messages import BlockState, Measurement
from dbc import indices as od
from dbc.canopen import (
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    NmtCommand,
    NmtState,
)
from dbc.configuration import calibration, configuration, expected_signature
from dbc.contract import Contract, NodeContract
from dbc.frame import Frames, frames
from dbc.steps import FIRST_MAX, PART_SUMS, WORD_BYTES, slot_byte, write_word
from nodes.steps.stepping import new_state, offer, threshold, whole
from skin.walsh import grouped_rows
from tests.bus.harness import frame
from tests.layouts import STEPPED, buses, small_layout
from tests.world import World

STEP_S = 0.005
HEARTBEAT_S = 1.0
VARIANCE_N2, NOISE_N, QUIET = np.zeros(PART_SUMS, np.float32), 1e-4, 0.1
NO_OBJECT = 0x0602_0000

STATES = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


def small_stepped(**tables: Any) -> Contract:
    """Return the contract of four patches of 4 x 8 taxels on two buses."""
    given = {"bus": buses(2, 2), "steps": {"slot_s": STEP_S}} | tables
    return Contract.from_layout(small_layout(8, 16, **STEPPED | given))


class SdoServer:
    """What a node answers to SDO: `objects` are the values by index and sub-index."""

    def __init__(self, contract: Contract, node: NodeContract) -> None:
        settings, gains = configuration(contract, node), calibration(contract, node)
        self.objects = {(each.index, each.subindex): each.data for each in (*settings, *gains)}
        for index in (od.SIGNATURE, od.CALIBRATION_SIGNATURE):
            self.objects[index, 0] = expected_signature(settings).to_bytes(4, "little")
        #: What is left of an answer in segments.
        self.rest = b""

    def written(self, place: tuple[int, int], value: bytes) -> None:
        """Take a value that was written."""
        self.objects[place] = value

    def answer(self, data: bytes) -> bytes:
        """Return the answer to a request."""
        place, key = data[1:4], (int.from_bytes(data[1:3], "little"), data[3])
        if data[0] & 0xE0 == 0x20:
            self.written(key, data[4 : 8 - (data[0] >> 2 & 3)])
            return b"\x60" + place + bytes(4)
        if data[0] & 0xE0 == 0x60:
            part, self.rest = self.rest[:7], self.rest[7:]
            return bytes((data[0] & 0x10 | 7 - len(part) << 1 | (not self.rest),)) + part.ljust(7, b"\0")
        value = self.objects.get(key)
        if value is None:
            return b"\x80" + place + NO_OBJECT.to_bytes(4, "little")
        if len(value) > 4:
            self.rest = value
            return b"\x41" + place + len(value).to_bytes(4, "little")
        return bytes((0x43 | 4 - len(value) << 2,)) + place + value.ljust(4, b"\0")


class Board(SdoServer):
    """One node: its sums are what the test says."""

    def __init__(self, contract: Contract, node: NodeContract) -> None:
        super().__init__(contract, node)
        self.contract, self.skin = node, contract
        self.forms = np.array(node.forms, np.int64)
        self.objects[od.NODE_NOISE, 0] = struct.pack("<f", 1e-4 * (node.block + 1))
        self.sums_n = np.zeros(32, np.float32)
        #: Times of requests to send all sums again, and what was written.
        self.asked: list[tuple[float, int]] = []
        #: The time now, when the newest SYNC came, and its counter.
        self.now_s = self.sync_s = 0.0
        self.counter = 0
        #: Frames with sums so far.
        self.sent = 0
        self.answers, self.speaks, self.beats = True, True, True
        self.boot()

    def written(self, place: tuple[int, int], value: bytes) -> None:
        if place == (od.REFRESH, 0):
            self.asked.append((self.now_s, value[0]))
            self.again()
        else:
            super().written(place, value)

    def boot(self) -> None:
        self.sending = new_state(len(self.forms), 1, PART_SUMS)
        self.slot: int | None = None
        self.state, self.beat_s, self.is_up = NmtState.PRE_OPERATIONAL, 0.0, False

    def again(self) -> None:
        """Send all sums."""
        self.sending.unset[0] = 0

    def tick(self, now_s: float) -> Frames:
        """Return what the board sends now."""
        out, node_id = [], self.contract.node_id
        if not self.is_up:
            self.is_up, self.beat_s = True, now_s + HEARTBEAT_S
            return frame(HEARTBEAT_BASE + node_id, b"\0")
        if now_s >= self.beat_s and self.beats:
            self.beat_s += HEARTBEAT_S
            out.append(frame(HEARTBEAT_BASE + node_id, bytes((self.state,))))
        if self.state is NmtState.OPERATIONAL and self.speaks:
            out += self.send(now_s)
        return np.concatenate(out) if out else frames(0)

    def send(self, now_s: float) -> list[Frames]:
        skin, parts = self.skin, len(self.forms)
        slot_s, slots, cycle = skin.layout.steps.slot_s, skin.slots, skin.slot_cycle
        since = int((now_s - self.sync_s) / slot_s + 1e-6)
        if not self.counter or not 0 <= since < 2 * slots:
            return []
        slot = ((self.counter - 1) * slots + since) % cycle
        if self.slot is not None and not 0 < (slot - self.slot) % cycle <= cycle - slots:
            return []
        self.slot, wanted, least, first = slot, np.zeros((parts, PART_SUMS), np.int64), 0.0, 0
        for part, form in enumerate(self.contract.forms):
            whole(self.sums_n[first : first + form.sums], skin.unit_n, form, wanted[part])
            least += threshold(VARIANCE_N2, NOISE_N, self.sums_n.size, skin.unit_n, QUIET, form)
            first += form.sums
        if not offer(0, 0, parts, wanted, least, slot, cycle, skin.keep_max, self.forms, self.sending):
            return []
        (tpdo,), self.sent = self.contract.tpdos, self.sent + 1
        data = np.zeros(tpdo.length, np.uint8)
        data[0] = slot_byte(slot)
        for part in range(parts):
            write_word(self.sending.word[part], data[1 + WORD_BYTES * part :])
        return [frame(tpdo.cob_id, data.tobytes(), flags=self.contract.flags)]

    def take(self, arrived: Frames, now_s: float) -> Frames:
        """Return what the board answers."""
        out, self.now_s = [], now_s
        for each in arrived:
            can_id, data = int(each["can_id"]), each["data"][: each["length"]].tobytes()
            if can_id == NMT_COB_ID and data[1] in {0, self.contract.node_id}:
                self.command(NmtCommand(data[0]))
            elif can_id == SYNC_COB_ID:
                self.sync_s, self.counter = int(each["time_ns"]) * 1e-9, data[0]
            elif can_id == SDO_REQUEST_BASE + self.contract.node_id and data[0] != 0x80 and self.answers:
                out.append(frame(SDO_RESPONSE_BASE + self.contract.node_id, self.answer(data)))
        return np.concatenate(out) if out else frames(0)

    def command(self, command: NmtCommand) -> None:
        if command not in STATES:
            self.boot()
            return
        if command is NmtCommand.START and self.state is not NmtState.OPERATIONAL:
            self.again()
        self.state = STATES[command]


class BoardsOfBus:
    """The boards of one bus, in place of a `Segment`."""

    def __init__(self, boards: list[Board], send: Callable[[Frames], int]) -> None:
        self.boards = boards
        self._send = lambda burst: len(burst) and send(burst)

    def boot(self, now_s: float) -> None:
        self.tick(now_s)

    def tick(self, now_s: float) -> None:
        for board in self.boards:
            self._send(board.tick(now_s))

    def take(self, arrived: Frames, now_s: float) -> None:
        for board in self.boards:
            self._send(board.take(arrived, now_s))


@dataclass
class BoardWorld(World):
    """A world of such boards."""

    step_s: ClassVar[float] = STEP_S
    hears_sync_first: ClassVar[bool] = False

    def new_hardware(self) -> list[Board]:
        return [Board(self.contract, node) for node in self.contract.nodes]

    def new_segment(self, bus: int, contract: Contract) -> BoardsOfBus:
        return BoardsOfBus([each for each in self.boards if each.contract.bus == bus], self.wires[bus].nodes.send)

    @property
    def boards(self) -> list[Board]:
        boards: list[Board] = self.hardware
        return boards

    def _wrong_blocks(self, measurement: Measurement) -> list[int]:
        """Return none: tests compare what is held with `known_counts`."""
        return []

    def touch(self, block: int, seed: int = 1, size_n: float = 0.05) -> None:
        """Let a board feel something."""
        sums_n = np.random.default_rng(seed).uniform(-size_n, size_n, 32)
        sums_n[0] = min(abs(sums_n[0]), FIRST_MAX * self.contract.unit_n)
        self.boards[block].sums_n = sums_n.astype(np.float32)

    def known_counts(self, block: int) -> npt.NDArray[np.int64]:
        """Return what a receiver without losses holds of a board, as a measurement has it."""
        board, by_row = self.boards[block], np.zeros(32)
        known = [each[: form.sums] for each, form in zip(board.sending.known, board.contract.forms, strict=True)]
        by_row[grouped_rows(32).ravel()] = np.concatenate(known)
        return np.rint(by_row * (self.contract.unit_n / self.contract.layout.taxels.newton_per_count)).astype(np.int64)

    def holds_what_boards_hold(self) -> bool:
        self.run(0.3)
        return all(np.array_equal(sums_of(self.measured[-1], block), self.known_counts(block)) for block in range(4))


def states(measurement: Measurement) -> list[BlockState]:
    return [BlockState(each) for each in measurement.states]


def sums_of(measurement: Measurement, block: int) -> npt.NDArray[np.int32]:
    return np.frombuffer(measurement.sums, "<i4").reshape(-1, 32)[block]


def known_of(measurement: Measurement, block: int) -> npt.NDArray[np.uint8]:
    return np.frombuffer(measurement.known, np.uint8).reshape(-1, 32)[block]


def at_rest(world: BoardWorld) -> None:
    """Go on until a still board sends a check after its longest silence only."""
    world.run(6.0)


def lose(world: BoardWorld, *blocks: int) -> None:
    """Touch boards anew, and lose their next frames."""
    for block in blocks:
        world.touch(block, seed=17)
    lost = {(block.bus, block.tpdos[0].cob_id) for block in (world.boards[each].contract for each in blocks)}
    for bus, wire in enumerate(world.wires):
        wire.loses = lambda _end, each, bus=bus: (bus, each["can_id"]) in lost  # type: ignore[misc]
    world.step()
    for wire in world.wires:
        wire.loses = None
