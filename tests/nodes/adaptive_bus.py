"""Adaptive nodes of one bus, their wire, a receiver, and a clock that the test moves."""

import struct
from collections.abc import Iterator

import numpy as np

from dbc.adaptive import FIRST_COB_ID, Companding, frame_of
from dbc.contract import Contract
from dbc.frame import FD, Frames, frame_bytes
from gateway.adaptive_state import BusSums, new_sums, take_all
from nodes.adaptive.boards import AdaptiveBoards
from nodes.adaptive.sending import NOT_DUE, Groups, tpdo_of
from nodes.segment import Segment
from nodes.virtual_boards import VirtualBoards
from skin.sources import Frame
from tests.bus.harness import frame
from tests.layouts import GROUPS, NODES, TPDOS
from tests.nodes.helpers import START, ArrayLink

IDS = (1, 2, 3, 4)


class Press:
    """Nothing, then from a step on an even force on every taxel."""

    has_noise = False

    def __init__(self, contract: Contract, from_step: int = 10, force_n: float = 0.008) -> None:
        taxels = contract.layout.taxels
        shape = taxels.rows, taxels.columns
        self._from = from_step
        # Neighbours differ, so that sums of every group do.
        self.force_n = np.random.default_rng(5).uniform(0.5, 1.5, shape).astype(np.float32) * np.float32(force_n)

    def frame(self, step: int) -> Frame:
        is_on = step >= self._from
        return Frame(self.force_n if is_on else np.zeros_like(self.force_n), "thing" if is_on else "")


class Bus:
    """Nodes 1 to 4 of bus0, the wire, a receiver, and a clock that the test moves."""

    def __init__(self, contract: Contract, **options: object) -> None:
        self.contract = contract
        self.source = Press(contract)
        blocks = [node.block for node in contract.on_bus(0) if node.node_id in IDS]
        self.boards = AdaptiveBoards(contract, blocks, self.source, noise_n=0.0, **options)  # type: ignore[arg-type]
        self.link = ArrayLink()
        self.complaints: list[str] = []
        nodes = VirtualBoards(contract, 0, IDS, self.boards)
        self.segment = Segment(contract, 0, nodes, self.boards, self.link.send, complain=self.complaints.append)
        self.now_s = 100.0
        self.received: BusSums = new_sums(NODES, GROUPS)
        self.is_fd = contract.layout.bus[0].fd
        self.segment.boot(self.now_s)
        self.link.take_sent()

    def give(self, *arrived: Frames) -> Frames:
        """Let frames arrive, and return what the nodes answer at once."""
        self.link.take_sent()
        self.link.waiting.extend(arrived)
        self.segment.take(self.link.receive(), self.now_s)
        return self.link.take_sent()

    def run(self, ticks: int) -> Frames:
        """Go on by `ticks` milliseconds; every frame arrives. Return frames of sums, which the receiver has taken."""
        sent = []
        for _ in range(ticks):
            self.segment.take(self.link.receive(), self.now_s)
            self.now_s += 1e-3
            self.segment.tick(self.now_s)
            sent.append(sums_of(self.link.take_sent()))
        self.segment.take(self.link.receive(), self.now_s)
        together = np.concatenate(sent)
        receive(together, self.contract.law, self.received, is_fd=self.is_fd)
        return together

    def start(self) -> None:
        self.give(frame(0, bytes((START, 0))))

    def sync(self, counter: int = 1) -> None:
        self.give(frame(0x80, bytes((counter,)), time_ns=round(self.now_s * 1e9)))

    def sdo(self, node_id: int, request: bytes) -> bytes:
        answers = self.give(frame(0x600 + node_id, request.ljust(8, b"\0")))
        (answer,) = answers[answers["can_id"] == 0x580 + node_id]
        return answer["data"][:8].tobytes()

    def write(self, index: int, sub: int, data: bytes, node_id: int = 1) -> int:
        answer = self.sdo(node_id, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data)
        return int(struct.unpack("<I", answer[4:])[0]) if answer[0] == 0x80 else 0

    def read(self, index: int, sub: int = 0, node_id: int = 1) -> bytes:
        answer = self.sdo(node_id, struct.pack("<BHB", 0x40, index, sub))
        assert answer[0] & 0xE0 == 0x40, answer.hex()
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        answer = self.sdo(node_id, b"\x60")  # eight bytes come in two segments
        return answer[1:] + self.sdo(node_id, b"\x70")[1:2]

    def read_real(self, index: int, sub: int = 0, node_id: int = 1) -> float:
        return float(struct.unpack("<f", self.read(index, sub, node_id))[0])


def due_frames(groups: Groups) -> Iterator[tuple[int, int]]:
    """Give group and identifier of the most urgent frame of a single node, until every frame is noted as sent."""
    while due := [(tpdo_of(0, group, groups), group) for group in range(GROUPS) if groups.level[0, group] != NOT_DUE]:
        tpdo, group = min(due)
        yield group, FIRST_COB_ID + NODES * tpdo


def receive(sent: Frames, law: Companding, sums: BusSums, *, is_fd: bool = False) -> None:
    """Give frames to a gateway that has proven all nodes and lost nothing."""
    nodes = len(sums.check)
    take_all(frame_bytes(sent), False, law, np.ones(nodes, np.bool_), sums, np.zeros((nodes, GROUPS), np.bool_), is_fd)


def sums_of(sent: Frames) -> Frames:
    return sent[(sent["can_id"] >= FIRST_COB_ID) & (sent["can_id"] < FIRST_COB_ID + NODES * TPDOS)]


def meanings(sent: Frames) -> list[tuple[int, int, int, bool]]:
    found = (frame_of(int(one["can_id"]), groups=GROUPS, is_fd=bool(one["flags"] & FD)) for one in sent)
    return [(column + 1, level, group, is_fine) for column, level, group, is_fine in found]


def back(sent: Frames, flags: int) -> Frames:
    returned = sent.copy()
    returned["flags"] |= flags
    return returned
