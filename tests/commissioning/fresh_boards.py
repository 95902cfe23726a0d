"""Boards without node-ID on one arbitrated bus, and a `skin commission` whose clock the test moves."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from commissioning.board_steps import Commissioning
from commissioning.serial_commissioning import SerialCommissioning
from commissioning.touch_commissioning import TouchCommissioning
from dbc.contract import Contract, NodeContract
from dbc.frame import Frames, frames
from nodes.firmware.library import Firmware
from nodes.hardware import Hardware
from nodes.node import SkinNode
from nodes.segment import Boards, Segment
from nodes.sending import sending_of
from nodes.virtual_boards import VirtualBoards
from skin.sources import Frame
from tests.gateway.drives import SharedWire
from tests.layouts import buses, small_layout

#: A board answers after at most this time.
SLOWEST_NS = 20_000_000


def skin(nodes: int, **tables: Any) -> Contract:
    """Return the contract of boards of 32 taxels on one bus of 1 Mbit/s."""
    return Contract.from_layout(small_layout(8, 4 * nodes, **{"bus": buses(nodes)} | tables))


class Finger:
    """A touch that the test moves: forces on all taxels of some blocks."""

    has_noise = True

    def __init__(self, contract: Contract) -> None:
        self._taxels, self._chains = contract.layout.taxels, contract.phi.taxels_of_blocks
        self.blocks: tuple[int, ...] = ()
        #: Deviation of a bell of force around the middle of each block; None: some taxels of the block alone.
        self.width_m: float | None = None

    def frame(self, step: int) -> Frame:
        force_n = np.zeros(self._taxels.count, np.float32)
        if self.width_m is None:
            # Neighbours differ, so that sums of every Hadamard row do.
            force_n[self._chains[list(self.blocks), ::3].ravel()] = 0.5 * self._taxels.force_max_n
        else:
            positions_m = self._taxels.surface.positions_m
            for block in self.blocks:
                away_m = np.linalg.norm(positions_m - positions_m[self._chains[block]].mean(axis=0), axis=1)
                force_n += 0.5 * self._taxels.force_max_n * np.exp(-0.5 * (away_m / self.width_m) ** 2)
        return Frame(force_n.reshape(self._taxels.rows, self._taxels.columns), "")


@dataclass
class Place:
    """A board and its controller."""

    segment: Segment
    hardware: Hardware
    arrived: list[Frames]
    #: The board has power while this is true; called with each request of LSS before the board takes the request.
    lives: Callable[[bytes], bool] = lambda _: True
    is_alive: bool = True

    @property
    def boards(self) -> Boards:
        return self.segment.boards

    @property
    def node(self) -> SkinNode:
        """Of a board in Python: what it is by its node-ID."""
        assert isinstance(self.boards, VirtualBoards)
        return self.boards.nodes[0]


class Bench:
    """A bus, its boards, and the master; time is that of the bus."""

    def __init__(self, contract: Contract, seed: int = 1) -> None:
        self.contract = contract
        self.wire = SharedWire(contract.layout.bus[0].bitrate, seed=seed)
        self.random = np.random.default_rng(seed)
        self.wire.now_ns = self.now_ns = 10**9
        self.places: list[Place] = []
        self.finger = Finger(contract)
        #: What the master's controller reports in each turn.
        self.noise = frames(0)

    def add(self, node_id: int, *, contract: Contract | None = None, numbered: bool = False) -> Place:
        """Connect a board and power it up."""
        built = contract or self.contract
        node = built.on_bus(0)[node_id - 1]
        hardware = self.hardware(built, node)
        return self.connect(VirtualBoards(built, 0, {node_id}, hardware, unnumbered=not numbered), hardware)

    def add_firmware(self, node_id: int, *, contract: Contract | None = None, store: Path | None = None) -> Place:
        """Connect a board in C without node-ID, and power it up."""
        built = contract or self.contract
        node = built.on_bus(0)[node_id - 1]
        firmware = Firmware(built, [node], store=store, unnumbered=True)
        return self.connect(firmware.boards(0), self.hardware(built, node, firmware))

    def hardware(self, contract: Contract, node: NodeContract, firmware: Firmware | None = None) -> Hardware:
        """Return what samples the taxels of a node: the finger touches them."""
        return sending_of(contract.layout).hardware(contract, [node.block], self.finger, firmware)

    def connect(self, boards: Boards, hardware: Hardware) -> Place:
        arrived: list[Frames] = []
        submit = self.wire.join(f"board {len(self.places)}", arrived.append)

        def send(burst: Frames) -> int:
            late = burst.copy()
            late["port"] = late["expires_ns"] = 0
            late["time_ns"] = self.now_ns + self.random.integers(50_000, SLOWEST_NS)
            return submit(late)

        segment = Segment(self.contract, 0, boards, hardware, send, complain=lambda _: None)
        place = Place(segment, hardware, arrived)
        self.places.append(place)
        segment.boot(self.now_s)
        return place

    def send(self, burst: Frames) -> int:
        """Send frames of the master."""
        return self.wire.gateway.send(burst)

    def commission(
        self, *, stop_after: Callable[[Commissioning], bool] = lambda _: False, **options: Any
    ) -> Commissioning:
        """Commission by serial numbers."""
        return self.run(SerialCommissioning(self.contract, 0, self.send, self.now_s, **options), stop_after=stop_after)

    def touch(
        self,
        say: Callable[[str], None],
        *,
        stop_after: Callable[[Commissioning], bool] = lambda _: False,
        **options: Any,
    ) -> Commissioning:
        """Commission by touch; `say` moves `finger`."""
        run = TouchCommissioning(self.contract, 0, self.send, self.now_s, say=say, **options)
        return self.run(run, stop_after=stop_after)

    def run(
        self, run: Commissioning, *, stop_after: Callable[[Commissioning], bool] = lambda _: False
    ) -> Commissioning:
        while not run.done:
            self._step(run)
            if not run.done and stop_after(run):
                run.give_up()
        return run

    def is_configured(self, place: int) -> bool:
        """Tell whether a board is in the state LSS configuration: nothing but its LED shows it."""
        boards = self.places[place].boards
        assert isinstance(boards, VirtualBoards)
        return boards._boards[0].slave.is_configured

    @property
    def now_s(self) -> float:
        return self.now_ns * 1e-9

    def _step(self, run: Commissioning) -> None:
        due_ns = [self.now_ns + 20_000_000, self.wire.bus.next_event_ns() or 2**62]
        dues_s = [
            run.due_s,
            *(each.boards.due_s for each in self.places),
            *(each.hardware.due_s for each in self.places),
        ]
        due_ns += [round(each * 1e9) + 1 for each in dues_s if self.now_s < each < 1e9]
        self.wire.now_ns = self.now_ns = max(min(due_ns), self.now_ns + 1000)
        self.wire.deliver()
        for place in self.places:
            arrived = np.concatenate([frames(0), *place.arrived])
            place.arrived.clear()
            for each in arrived:
                if each["can_id"] == 0x7E5:
                    place.is_alive = place.is_alive and place.lives(each["data"][:8].tobytes())
            if place.is_alive:
                if len(arrived):
                    place.segment.take(arrived, self.now_s)
                place.segment.tick(self.now_s)
        run.take(np.concatenate([self.wire.gateway.receive(), self.noise]), self.now_s)
        run.tick(self.now_s)
        self.wire.deliver()


def complete(run: Commissioning) -> set[int]:
    return {node_id for node_id, board in run.boards.items() if board.is_complete}


FOREIGN = {"device": {"first_serial": 1000}}


class DiesBeforeStoring:
    """Loses power when the node-ID that was given last is to be stored, and is `node_id`."""

    def __init__(self, node_id: int) -> None:
        self._node_id, self._given = node_id, 0

    def __call__(self, request: bytes) -> bool:
        self._given = request[1] if request[0] == 0x11 else self._given
        return request[0] != 0x17 or self._given != self._node_id


def check_commissioning(nodes: int, add: Callable[[Bench, int], Place] = Bench.add) -> float:
    """Commission boards: one dies, two have one serial number, one is a stranger; return seconds of the bus."""
    bench = Bench(skin(nodes))
    for node_id in range(1, nodes + 1):
        add(bench, node_id)
    add(bench, 2)
    bench.add(1, contract=skin(nodes, **FOREIGN))
    bench.places[2].lives = DiesBeforeStoring(3)
    started_s = bench.now_s
    run = bench.commission()
    assert complete(run) == set(range(1, nodes + 1)) - {2, 3}
    assert "two boards answer: they have one serial number" in run.boards[2].text
    assert (
        "stopped answering at the storage of its node-ID (so far: has node-ID 3 until its power is cut)"
        in run.boards[3].text
    )
    assert len(run.strangers) == 1
    assert "serial number 1000: not a board of this skin" in run.strangers[0]
    assert not run.is_whole
    return bench.now_s - started_s
