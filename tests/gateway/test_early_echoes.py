"""Boards behind adapters that echo SYNC early, and hold back what they send and receive: no valid block is wrong."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.messages import UNKNOWN_ERROR_NS
from dbc.canopen import SYNC_COB_ID
from tests.layouts import small_contract
from tests.world import BOUND_S, PERIOD_S, RANDOM, Line, Wire, World, skip_pauses, valid

CONTRACT = small_contract()
NODES = [(node.bus, node.node_id) for node in CONTRACT.nodes]
STEPS_PER_PERIOD = 4


class Adapter(Wire):
    """A bus behind a USB adapter: an echo comes before its frame is sent, and everything waits on its way."""

    proves_echo = False
    echoes_early = True


@dataclass
class AdapterWorld(World):
    """A skin behind such adapters, looked at several times in a period."""

    step_s: ClassVar[float] = PERIOD_S / STEPS_PER_PERIOD
    wire: ClassVar[type[Wire]] = Adapter

    def ways(self, bus: int) -> dict[str, Line]:
        """Return where frames wait in an adapter."""
        return {"transmit": self.wires[bus].transmit, "receive": self.wires[bus].gateway.arriving}

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
            world.ways(bus)[way].delay_ns = delay_ns
            world.checked(PERIOD_S)
        case ("hang", (bus, node_id), periods):
            line = world.wires[bus].line(node_id)
            line.delay_ns = round(periods * PERIOD_S * 1e9)
            world.checked(PERIOD_S)
            line.delay_ns = 0
        case ("lose", (bus, _), periods):
            wire = world.wires[bus]
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
        for line in world.ways(bus).values():
            line.delay_ns = 0
    world.checked(3 * PERIOD_S * 4)
    skip_pauses(world)
    world.until_whole(BOUND_S)


@pytest.mark.parametrize("delay", [(0, 0), (1, 0), (0, 1), (1, 1), (4, 1), (2, 4)])
def test_behind_an_adapter_whose_delay_is_steady_every_block_is_valid(delay: tuple[int, int]) -> None:
    """Also if an answer comes after the next SYNC was handed over: the frame names its cycle."""
    world = AdapterWorld(CONTRACT)
    for bus in (0, 1):
        for line, steps in zip(world.ways(bus).values(), delay, strict=True):
            line.delay_ns = round(steps * world.step_s * 1e9)
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
