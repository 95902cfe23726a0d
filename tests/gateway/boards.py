"""Adaptive boards that only answer SDO, NMT and send sums, with their gateway, in one thread on wires of arrays."""

import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.link import State
from canskin.messages import BlockState, GatewayStatus, Measurement
from dbc import indices as od
from dbc.adaptive import Companding, SendingRule
from dbc.canopen import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, NmtCommand, NmtState
from dbc.configuration import configuration, expected_signature
from dbc.contract import Contract, NodeContract, frame_flags
from dbc.frame import Frames, frames
from gateway.adaptive_gathering import RATES_HZ
from gateway.loop import GatewayLoop
from nodes.adaptive.sending import NEWS, Groups, decide, make_payload, new_groups, note_sent
from skin.walsh import grouped_rows
from tests.bus.harness import frame
from tests.gateway.helpers import Wire
from tests.layouts import ADAPTIVE, GROUPS, buses, small_layout
from tests.nodes.adaptive_bus import due_frames

STEP_S = 0.005
HEARTBEAT_S = 1.0
RULE, VARIANCE_N2, NOISE_N2 = SendingRule(), np.zeros(32, np.float32), 1e-9
NO_OBJECT = 0x0602_0000

STATES = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


def small_adaptive(**tables: Any) -> Contract:
    """Return the contract of four patches of 4 x 8 taxels on two buses."""
    return Contract.from_layout(small_layout(8, 16, **ADAPTIVE | {"bus": buses(2, 2)} | tables))


def send(groups: Groups, group: int, now: int, sums_n: np.ndarray, law: Companding) -> np.ndarray:
    """Return the payload of a group's frame, which is sent at once."""
    payload, is_fine = np.zeros(64, np.uint8), bool(groups.is_fine[0, group])
    length = make_payload(0, group, sums_n, law, groups, payload)
    note_sent(0, 0 if groups.is_fd[0] else group, now, is_fine, RULE, law, groups, payload)
    return payload[:length]


class Board:
    """One node: its sums are what the test says."""

    def __init__(self, contract: Contract, node: NodeContract) -> None:
        settings = configuration(contract, node)
        self.contract, self.law = node, contract.law
        self.line = contract.layout.bus[node.bus]
        self.objects = {(each.index, each.subindex): each.data for each in settings}
        self.objects[od.SIGNATURE, 0] = expected_signature(settings).to_bytes(4, "little")
        self.objects[od.NODE_NOISE, 0] = struct.pack("<f", 1e-4 * (node.block + 1))
        self.sums_n = np.zeros(32, np.float32)
        #: Times and groups of requests to send again.
        self.asked: list[tuple[float, int]] = []
        #: What is left of an answer in segments.
        self.rest = b""
        #: Frames with sums so far.
        self.sent = 0
        self.answers, self.speaks, self.beats = True, True, True
        self.boot()

    def boot(self) -> None:
        self.groups: Groups = new_groups(1, GROUPS, self.line.fd)
        self.forced = 0
        self.state, self.beat_s, self.is_up = NmtState.PRE_OPERATIONAL, 0.0, False

    def again(self, groups: int) -> None:
        """Send groups in coarse frames."""
        self.forced |= groups

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
            out += self.send(round(now_s * 1e3))
        return np.concatenate(out) if out else frames(0)

    def send(self, now: int) -> list[Frames]:
        decide(0, now, self.sums_n, VARIANCE_N2, NOISE_N2, RULE, self.law, self.groups)
        out, groups = [], self.groups
        for group in range(GROUPS):
            if self.forced >> group & 1:
                groups.level[0, group], groups.reason[0, group], groups.is_fine[0, group] = 0, NEWS, 0
        for group, can_id in due_frames(groups):
            payload = send(groups, group, now, self.sums_n, self.law)
            out.append(frame(can_id + self.contract.node_id - 1, payload.tobytes(), flags=frame_flags(self.line)))
        self.forced = 0
        self.sent += len(out)
        return out

    def take(self, arrived: Frames, now_s: float) -> Frames:
        """Return what the board answers."""
        out = []
        for each in arrived:
            can_id, data = int(each["can_id"]), each["data"][: each["length"]].tobytes()
            if can_id == NMT_COB_ID and data[1] in {0, self.contract.node_id}:
                self.command(NmtCommand(data[0]))
            elif can_id == SDO_REQUEST_BASE + self.contract.node_id and data[0] != 0x80 and self.answers:
                out.append(frame(SDO_RESPONSE_BASE + self.contract.node_id, self.answer(data, now_s)))
        return np.concatenate(out) if out else frames(0)

    def command(self, command: NmtCommand) -> None:
        if command not in STATES:
            self.boot()
            return
        if command is NmtCommand.START and self.state is not NmtState.OPERATIONAL:
            self.again(0b1111)
        self.state = STATES[command]

    def answer(self, data: bytes, now_s: float) -> bytes:
        place, key = data[1:4], (int.from_bytes(data[1:3], "little"), data[3])
        if data[0] & 0xE0 == 0x20:
            value = data[4 : 8 - (data[0] >> 2 & 3)]
            if key == (od.REFRESH, 0):
                self.asked.append((now_s, value[0]))
                self.again(value[0])
            else:
                self.objects[key] = value
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


@dataclass
class BoardWorld:
    """Boards, wires, and a gateway; `dropped` and `link` are what the gateway's links say."""

    contract: Contract
    now_s: float = 100.0
    rates_hz: tuple[float, float] = RATES_HZ
    lines: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    measured: list[Measurement] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.wires = [Wire() for _ in self.contract.layout.bus]
        self.boards = [Board(self.contract, node) for node in self.contract.nodes]
        self.dropped = [0] * len(self.wires)
        self.link = [State.ACTIVE] * len(self.wires)
        self.gateway = self.new_gateway()

    def new_gateway(self) -> GatewayLoop:
        for wire in self.wires:
            wire.gateway.waiting.clear()
        return GatewayLoop(
            self.contract,
            {bus: wire.gateway.send for bus, wire in enumerate(self.wires)},
            self.now_s,
            say=self.lines.append,
            complain=self.complaints.append,
            rates_hz=self.rates_hz,
        )

    def step(self) -> list[Measurement]:
        self.now_s += STEP_S
        came: list[Measurement] = []
        self.gateway.tick(self.now_s)
        came += self.gateway.send_sync(self.now_s)
        for board in self.boards:
            if len(sent := board.tick(self.now_s)):
                self.wires[board.contract.bus].nodes.send(sent)
        self.carry()
        came += self.gateway.measurements(self.now_s)
        self.measured += came
        return came

    def carry(self) -> None:
        for wire in self.wires:
            wire.now_ns = round(self.now_s * 1e9)
        while sum(wire.deliver() for wire in self.wires) or any(wire.gateway.has_news for wire in self.wires):
            for bus, wire in enumerate(self.wires):
                arrived = wire.nodes.receive()
                for board in self.boards:
                    if board.contract.bus == bus and len(answers := board.take(arrived, self.now_s)):
                        wire.nodes.send(answers)
                self.receive(bus)

    def receive(self, bus: int) -> None:
        arrived = self.wires[bus].gateway.receive()
        self.gateway.take(bus, arrived, self.now_s, state=self.link[bus], dropped=self.dropped[bus], stamp_error_ns=0)

    def run(self, seconds: float) -> list[Measurement]:
        first = len(self.measured)
        for _ in range(round(seconds / STEP_S)):
            self.step()
        return self.measured[first:]

    def until_whole(self, at_most_s: float) -> float:
        """Go on until every block is valid; return how long that took."""
        start_s = self.now_s
        while self.now_s - start_s < at_most_s:
            if any(all(each.valid) for each in self.step()):
                return self.now_s - start_s
        raise AssertionError(f"{list(states(self.measured[-1]))} {self.lines[-5:]}")

    def status(self) -> GatewayStatus:
        links = {bus: (self.link[bus], self.dropped[bus]) for bus in range(len(self.wires))}
        return self.gateway.status(links, self.now_s)

    def nmt(self, bus: int, command: int, node_id: int) -> None:
        self.wires[bus].put(NMT_COB_ID, bytes((command, node_id)))

    def touch(self, block: int, seed: int = 1, size_n: float = 0.05) -> None:
        """Let a board feel something."""
        sums_n = np.random.default_rng(seed).uniform(-size_n, size_n, 32)
        sums_n[0] = abs(sums_n[0])
        self.boards[block].sums_n = sums_n.astype(np.float32)

    def known_counts(self, block: int) -> npt.NDArray[np.int64]:
        """Return what a receiver without losses holds of a board, as a measurement has it."""
        by_row = np.zeros(32)
        by_row[grouped_rows(32).ravel()] = self.boards[block].groups.known_n[0]
        return np.rint(by_row / self.contract.layout.taxels.newton_per_count).astype(np.int64)


def states(measurement: Measurement) -> list[BlockState]:
    return [BlockState(each) for each in measurement.states]


def sums_of(measurement: Measurement, block: int) -> npt.NDArray[np.int32]:
    return np.frombuffer(measurement.sums, "<i4").reshape(-1, 32)[block]


def known_of(measurement: Measurement, block: int) -> npt.NDArray[np.uint8]:
    return np.frombuffer(measurement.known, np.uint8).reshape(-1, 32)[block]


def at_rest(world: BoardWorld) -> None:
    """Go on until every board that feels nothing has sent its last refresh."""
    world.run(3.5)


def lose(world: BoardWorld, bus: int, frames_lost: int = 1) -> None:
    world.dropped[bus] += frames_lost
    world.receive(bus)
