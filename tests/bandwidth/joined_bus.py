"""Stepped boards and a gateway on one arbitrated bus with exact bit times, in one thread: time is that of the bus."""

from functools import cache
from pathlib import Path

import numpy as np

from bus.link import Send, State
from bus.outbox import OTHERS, OWNER
from bus.simulated_bus import SimulatedBus
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from dbc.patch_filter import SAMPLE_NS
from gateway.loop import GatewayLoop
from nodes.segment import Segment
from nodes.steps.boards import SteppedBoards
from nodes.virtual_boards import VirtualBoards
from skin.layout import load_layout
from skin.sources import Frame


@cache
def shipped() -> Contract:
    """Return the contract of the shipped stepped layout."""
    return Contract.from_layout(load_layout(Path("steps")))


class Moving:
    """Some blocks feel other forces in every step; nothing touches the others."""

    has_noise = False

    def __init__(self, moving: frozenset[int], seed: int) -> None:
        layout, phi = shipped().layout, shipped().phi
        self._shape = layout.taxels.rows, layout.taxels.columns
        self._largest_n = layout.taxels.force_max_n
        self._moves = np.isin(phi.block_of_taxel, sorted(moving))
        self._seed = seed

    def frame(self, step: int) -> Frame:
        """Return the forces of a step."""
        force_n = np.random.default_rng([self._seed, step]).uniform(0, self._largest_n, self._moves.size)
        return Frame((force_n * self._moves).reshape(self._shape).astype(np.float32), "")


class JoinedBus:
    """The first bus of the shipped layout: boards that run, the wire, and the gateway of the moment."""

    def __init__(self, moving: frozenset[int], seed: int) -> None:
        contract, line = shipped(), shipped().layout.bus[0]
        nodes = contract.on_bus(0)
        self.boards = SteppedBoards(contract, [node.block for node in nodes], Moving(moving, seed), seed=seed)
        self._wire = SimulatedBus(line.bitrate, line.data_bitrate, seed=seed)
        self._stations = {name: self._wire.attach(name) for name in ("gateway", "nodes")}
        self._now_ns = SAMPLE_NS
        ids = {node.node_id for node in nodes}
        self._segment = Segment(
            contract,
            0,
            VirtualBoards(contract, 0, ids, self.boards),
            self.boards,
            self._sender("nodes"),
            complain=print,
        )
        self._segment.boot(self.now_s)
        self._blocks = slice(nodes[0].block, nodes[-1].block + 1)
        self._stalls, self._dropped = False, 0
        self.join()

    @property
    def now_s(self) -> float:
        """Time of the bus."""
        return self._now_ns * 1e-9

    def join(self) -> None:
        """Let a new gateway take the place of the one that runs."""
        self._dropped = 0
        self.gateway = GatewayLoop(
            shipped(), {0: self._sender("gateway")}, self.now_s, say=lambda _: None, complain=lambda _: None
        )

    def run(self, milliseconds: int) -> None:
        """Go on."""
        for _ in range(milliseconds):
            self._step()

    def stall(self, milliseconds: int) -> None:
        """Let the gateway do nothing, with a receive buffer that is too small: frames are lost, and counted."""
        self._stalls = True
        self.run(milliseconds)
        self._stalls = False

    def until_whole_ms(self, at_most_ms: int) -> int:
        """Go on until every block of the bus is valid; return how long that took."""
        for passed in range(1, at_most_ms):
            if self._step():
                return passed
        missing = np.flatnonzero(self._missing)
        raise AssertionError(f"not whole after {at_most_ms} ms: blocks {missing.tolist()}")

    def _sender(self, name: str) -> Send:
        def send(burst: Frames) -> int:
            return self._wire.submit(self._stations[name], burst, self._now_ns)

        return send

    def _step(self) -> bool:
        """Go on by a millisecond: boards and gateway read, and do what is due; tell whether all blocks are valid."""
        self._now_ns += SAMPLE_NS
        ended = self._wire.run_until(self._now_ns)
        came = {}
        for name, station in self._stations.items():
            is_own = ended.owner == station.number
            is_mine = ended.audience & np.where(is_own, OWNER, OTHERS) != 0
            came[name] = ended.frames[is_mine].copy()
            came[name]["flags"][is_own[is_mine]] |= ECHO
        self._segment.take(came["nodes"], self.now_s)
        self._segment.tick(self.now_s)
        if self._stalls:
            self._dropped += len(came["gateway"])
            return False
        self.gateway.take(0, came["gateway"], self.now_s, state=State.ACTIVE, dropped=self._dropped, stamp_error_ns=0)
        self.gateway.tick(self.now_s)
        made = [*self.gateway.send_sync(self.now_s), *self.gateway.measurements(self.now_s)]
        if made:
            self._missing = np.frombuffer(made[-1].valid, np.uint8)[self._blocks] == 0
        return bool(made) and not self._missing.any()
