"""Boards behind adapters that echo SYNC early, and hold back what they send and receive: no valid block is wrong."""

from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.messages import UNKNOWN_ERROR_NS
from dbc.canopen import SYNC_COB_ID
from dbc.frame import ECHO, Frames
from tests.gateway.helpers import BOUND_S, PERIOD_S, RANDOM, EndOfWire, Wire, World, skip_pauses, valid
from tests.layouts import small_contract

CONTRACT = small_contract()
NODES = [(node.bus, node.node_id) for node in CONTRACT.nodes]
STEPS_PER_PERIOD = 4


class Fifo:
    """What waits in a queue: first in, first out, each for a time of its own."""

    def __init__(self) -> None:
        self.delay_ns = 0
        self._waiting: deque[tuple[int, EndOfWire | None, Frames]] = deque()

    def put(self, sender: EndOfWire | None, burst: Frames, now_ns: int) -> None:
        self._waiting.append((now_ns + self.delay_ns, sender, burst))

    def due(self, now_ns: int) -> list[tuple[EndOfWire | None, Frames]]:
        out = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            out.append(self._waiting.popleft()[1:])
        return out

    def clear(self) -> None:
        self._waiting.clear()


class Adapter(Wire):
    """A bus behind a USB adapter: an echo comes before its frame is sent, and everything waits on its way."""

    def __init__(self) -> None:
        super().__init__()
        self.transmit, self.receive = Fifo(), Fifo()
        #: By node-ID: the frames of a board that hangs.
        self.hung: dict[int, Fifo] = {}

    def deliver(self) -> bool:
        sent, self.queue = self.queue, []
        going: list[tuple[EndOfWire | None, Frames]] = []
        for sender, burst in sent:
            if sender is self.gateway:
                echo = burst.copy()
                echo["flags"] |= ECHO
                self.gateway.waiting.append(echo)
                self.transmit.put(sender, burst, self.now_ns)
            else:
                going += self._of_boards(sender, burst)
        for fifo in self.hung.values():
            going += fifo.due(self.now_ns)
        going += self.transmit.due(self.now_ns)
        for sender, burst in going:
            before = len(self.gateway.waiting)
            self._carry(sender, burst)
            for arrived in self.gateway.waiting[before:]:
                if sender is not self.gateway:
                    self.receive.put(sender, arrived, self.now_ns)
            del self.gateway.waiting[before:]
        arrived = self.receive.due(self.now_ns)
        for _, burst in arrived:
            burst["time_ns"] = self.now_ns  # that of the read: the adapter has no clock
            self.gateway.waiting.append(burst)
        return bool(sent or going or arrived)

    def hold_back(self, node_id: int, delay_ns: int) -> None:
        """Let the frames of a board wait, and all behind them."""
        self.hung.setdefault(node_id, Fifo()).delay_ns = delay_ns

    def _of_boards(self, sender: EndOfWire | None, burst: Frames) -> list[tuple[EndOfWire | None, Frames]]:
        going = []
        for each in range(len(burst)):
            one = burst[each : each + 1]
            fifo = self.hung.get(int(one["can_id"][0]) & 0x7F) if sender is self.nodes else None
            if fifo is None:
                going.append((sender, one))
            else:
                fifo.put(sender, one, self.now_ns)
        return going


@dataclass
class AdapterWorld(World):
    """A skin behind such adapters, looked at several times in a period."""

    step_s: ClassVar[float] = PERIOD_S / STEPS_PER_PERIOD
    wire: ClassVar[type[Wire]] = Adapter
    early_echoes: ClassVar[tuple[int, ...]] = (0, 1)

    def adapter(self, bus: int) -> Adapter:
        wire = self.wires[bus]
        assert isinstance(wire, Adapter)
        return wire

    def checked(self, seconds: float) -> float:
        """Go on; check that no valid block is wrong; return the part of the blocks that is valid."""
        came = self.run(seconds)
        assert not any(self.wrong_blocks(each) for each in came)
        return float(np.mean([valid(each) for each in came])) if came else 0.0


STEPS_NS = st.integers(0, 3 * STEPS_PER_PERIOD).map(lambda steps: round(steps * PERIOD_S / STEPS_PER_PERIOD * 1e9))
BUS = st.sampled_from((0, 1))
EVENTS = st.one_of(
    st.tuples(st.just("transmit"), BUS, STEPS_NS),
    st.tuples(st.just("receive"), BUS, STEPS_NS),
    st.tuples(st.just("hang"), st.sampled_from(NODES), st.integers(1, 5)),
    st.tuples(st.just("lose"), st.sampled_from(NODES), st.integers(1, 2)),
    st.tuples(st.just("go on"), st.none(), st.integers(1, 12)),
)


def happen(world: AdapterWorld, what: tuple) -> None:
    match what:
        case ("transmit" | "receive" as way, bus, delay_ns):
            getattr(world.adapter(bus), way).delay_ns = delay_ns
            world.checked(PERIOD_S)
        case ("hang", (bus, node_id), periods):
            world.adapter(bus).hold_back(node_id, round(periods * PERIOD_S * 1e9))
            world.checked(PERIOD_S)
            world.adapter(bus).hold_back(node_id, 0)
        case ("lose", (bus, _), periods):
            wire = world.adapter(bus)
            wire.loses = lambda end, each: end is wire.nodes and each["can_id"] == SYNC_COB_ID
            world.checked(periods * PERIOD_S)
            wire.loses = None
        case ("go on", _, periods):
            world.checked(periods * PERIOD_S)


@settings(RANDOM, max_examples=25)
@given(st.lists(EVENTS, min_size=1, max_size=12))
def test_whatever_waits_in_adapters_and_boards_no_valid_block_is_wrong(events: list[tuple]) -> None:
    world = AdapterWorld(CONTRACT)
    world.until_whole(3.0)
    for what in events:
        happen(world, what)
    for bus in (0, 1):
        wire = world.adapter(bus)
        wire.transmit.delay_ns = wire.receive.delay_ns = 0
    world.checked(3 * PERIOD_S * 4)
    skip_pauses(world)
    world.until_whole(BOUND_S)


@pytest.mark.parametrize("delay", [(0, 0), (1, 0), (0, 1), (1, 1), (4, 1), (2, 4)])
def test_behind_an_adapter_whose_delay_is_steady_every_block_is_valid(delay: tuple[int, int]) -> None:
    """Also if an answer comes after the next SYNC was handed over: the frame names its cycle."""
    world = AdapterWorld(CONTRACT)
    for bus in (0, 1):
        wire = world.adapter(bus)
        wire.transmit.delay_ns, wire.receive.delay_ns = (round(each * world.step_s * 1e9) for each in delay)
    world.until_whole(3.0)
    assert world.checked(1.0) == 1.0
    for each in world.measured[-5:]:
        late_ns = sum(delay) * world.step_s * 1e9  # on this bus of no length an answer can come too early for any bound
        assert each.sampled_error_ns == (pytest.approx(late_ns, abs=2e6) if late_ns else UNKNOWN_ERROR_NS)


def test_a_lost_answer_and_a_late_board_cost_their_cycles_alone() -> None:
    world = AdapterWorld(CONTRACT)
    world.until_whole(3.0)
    happen(world, ("hang", NODES[0], 2))
    world.checked(3 * PERIOD_S)
    assert world.checked(3 * PERIOD_S) == 1.0
    happen(world, ("lose", NODES[0], 1))
    world.checked(PERIOD_S)
    assert world.checked(1.0) == 1.0
    assert not any("reset" in line for line in world.lines)
