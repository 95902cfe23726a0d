"""Stepped boards of one bus twice, in Python and in C: the same samples, frames, and fates of their frames."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from bus.link import DISCARDED
from dbc.canopen import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from nodes.firmware.library import Firmware
from nodes.segment import Segment
from nodes.steps.boards import SteppedBoards
from nodes.steps.firmware import FirmwarePatches
from nodes.virtual_boards import VirtualBoards
from skin.layout import load_layout
from skin.sources import Frame, TaxelSource
from tests.bus.harness import frame
from tests.layouts import small_boards

#: Boards of 32 taxels, and of other sizes; some places of the mats of 10 x 10 are empty.
SKINS = {
    "steps": lambda: load_layout(Path("steps")),
    "steps-fd": lambda: load_layout(Path("steps-fd")),
    "8": lambda: small_boards(8),
    "16": lambda: small_boards(16, 10, 10),
    "64": lambda: small_boards(64),
    "16-fd": lambda: small_boards(16, fd=True),
    "64-fd": lambda: small_boards(64, 10, 10, fd=True, data_bitrate=5_000_000),
}
#: Steps of 10 ms after which the touches come again.
STROKES_STEPS = 200


def contract_of(name: str) -> Contract:
    """Return the contract of one of `SKINS`."""
    return Contract.from_layout(SKINS[name]())


class Strokes:
    """Touches that come, slide and go near the patches of the first nodes of a bus, with pauses."""

    has_noise = False

    def __init__(self, contract: Contract, seed: int = 0, nodes: int = 3) -> None:
        self._taxels = contract.layout.taxels
        self._random = np.random.default_rng(seed)
        shape = self._taxels.rows, self._taxels.columns
        self._rows, self._columns = np.indices(shape)
        count, cells = 30, contract.phi.taxels_of_blocks[[node.block for node in contract.on_bus(0)[:nodes]]]
        self._from = self._random.integers(0, STROKES_STEPS - 30, count)
        self._long = self._random.integers(2, 60, count)
        there = cells[cells < self._taxels.count]
        at = np.stack(np.unravel_index(self._random.choice(there, count), shape), axis=1)
        self._at = at + self._random.normal(0, 2, (count, 2))
        self._speed = self._random.normal(0, 0.3, (count, 2))
        self._width = self._random.uniform(1, 8, count)
        self._force_n = self._random.uniform(0.0005, 0.04, count)

    def frame(self, step: int) -> Frame:
        force_n = np.zeros(self._rows.shape)
        step %= STROKES_STEPS
        for each in range(len(self._from)):
            since = step - self._from[each]
            if 0 <= since < self._long[each]:
                row, column = self._at[each] + self._speed[each] * since
                away = np.square(self._rows - row) + np.square(self._columns - column)
                force_n += self._force_n[each] * np.exp(-away / self._width[each] ** 2)
        return Frame(np.minimum(force_n, 2 * self._taxels.force_max_n).astype(np.float32), "")


class SteppedTwins:
    """Nodes 1 to `nodes` of a bus in Python (first) and in C (second), and a clock of whole milliseconds.

    Parameters
    ----------
    sent, given_up : float
        Chances of a frame to be sent, and to be given up, before the next sample; else the controller keeps it.
    keeps : float
        Chance of a kept frame to stay for another sample.
    """

    def __init__(
        self,
        contract: Contract,
        nodes: int = 3,
        source: TaxelSource | None = None,
        *,
        sent: float = 0.8,
        given_up: float = 0.05,
        keeps: float = 0.95,
        **analogue: Any,
    ) -> None:
        mine = contract.on_bus(0)[:nodes]
        ids, blocks = {node.node_id for node in mine}, [node.block for node in mine]
        source = source or Strokes(contract)
        firmware = Firmware(contract, mine)
        boards = SteppedBoards(contract, blocks, source, **analogue)
        patches = FirmwarePatches(contract, blocks, source, firmware, **analogue)
        self.boards = boards, patches
        self.out: tuple[list[Frames], list[Frames]] = [], []
        self.complaints: list[str] = []
        self.segments = (
            Segment(
                contract,
                0,
                VirtualBoards(contract, 0, ids, boards),
                boards,
                self._sender(0),
                complain=self.complaints.append,
            ),
            Segment(contract, 0, firmware.boards(0), patches, self._sender(1), complain=self.complaints.append),
        )
        self.ids, self.room, self.chances, self.keeps = ids, 1 << 30, (sent, given_up), keeps
        self.fates = np.random.default_rng(1)
        self.now_ms = 100_000
        self.held = frames(0)
        for segment in self.segments:
            segment.boot(self.now_s)
        self.taken()

    def _sender(self, which: int) -> Any:
        def send(burst: Frames) -> int:
            accepted: Frames = burst[: self.room].copy()
            self.out[which].append(accepted)
            return len(accepted)

        return send

    @property
    def now_s(self) -> float:
        return self.now_ms / 1000

    def taken(self) -> Frames:
        """Return what both have sent, by identifier, but for heartbeats, which have their own times.

        Raises AssertionError if they differ.
        """
        found = []
        for bursts in self.out:
            together = np.concatenate(bursts) if bursts else np.zeros(0, frame(0, b"").dtype)
            together = together[together["can_id"] < HEARTBEAT_BASE]
            found.append(np.sort(together, order=["can_id", "port", "data"]))
            bursts.clear()
        python, c = found
        assert [describe(each) for each in c] == [describe(each) for each in python]
        return python

    def put(self, arrived: Frames) -> Frames:
        """Let frames arrive; return what both answer at once."""
        for segment in self.segments:
            segment.take(arrived.copy(), self.now_s)
        return self.taken()

    def step(self) -> Frames:
        """Go on by a millisecond; return what was sent then."""
        self.now_ms += 1
        for segment in self.segments:
            segment.tick(self.now_s)
        sent = self.taken()
        drawn, stays = self.fates.random(len(sent)), self.fates.random(len(self.held)) < self.keeps
        own, gone = sent[drawn < sum(self.chances)].copy(), self.held[~stays]
        own["flags"] |= np.where(drawn[drawn < sum(self.chances)] < self.chances[0], ECHO, DISCARDED).astype(np.uint8)
        self.held = np.concatenate([self.held[stays], sent[drawn >= sum(self.chances)]])
        gone["flags"] |= ECHO
        if len(own) + len(gone):
            self.put(np.concatenate([gone, own]))
        return sent

    def run(self, milliseconds: int) -> int:
        """Go on; return how many frames were sent."""
        return sum(len(self.step()) for _ in range(milliseconds))

    def nmt(self, command: int, node_id: int = 0) -> None:
        self.put(frame(NMT_COB_ID, bytes((command, node_id))))

    def sync(self, counter: int = 1) -> None:
        self.put(frame(SYNC_COB_ID, bytes((counter,)), time_ns=self.now_ms * 1_000_000))

    def sdo(self, node_id: int, request: bytes) -> bytes:
        answers = self.put(frame(SDO_REQUEST_BASE + node_id, request.ljust(8, b"\0")))
        data: bytes = answers[0]["data"][:8].tobytes()
        return data

    def write(self, index: int, sub: int, data: bytes, node_id: int = 1) -> bytes:
        """Write an object; return the answer of both."""
        return self.sdo(node_id, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data)

    def read(self, index: int, sub: int = 0, node_id: int = 1) -> bytes:
        """Read an object of both, as both answer it."""
        answer = self.sdo(node_id, struct.pack("<BHB", 0x40, index, sub))
        return self.sdo(node_id, b"\x60")[1:] if answer[0] == 0x41 else answer[4:]


def describe(one: np.void) -> tuple[int, int, int, int, bytes]:
    """Return identifier, port, flags, latest start and payload of a frame."""
    data = one["data"][: one["length"]].tobytes()
    return int(one["can_id"]), int(one["port"]), int(one["flags"]), int(one["expires_ns"]), data
