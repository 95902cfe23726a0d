"""Frames that are late, held back, repeated, lost or of another master: each counts in the cycle that it names."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.link import State
from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract, sync_frame
from dbc.frame import ECHO, Frames, frames
from gateway.collector import Collector, Gathered
from gateway.cycle_gathering import CycleGathering
from gateway.gathering import Health
from tests.bus.harness import frame
from tests.layouts import small_contract
from tests.world import DISTURBANCES, PERIOD_S, RANDOM, World, valid

CONTRACTS = {1: small_contract(), 2: small_contract(sync={"rate_hz": 40.0, "turns": 2})}
#: Disturbances of an example.
STEPS = 200
#: What a board sends that another master's SYNC has asked for.
OTHER = -1

turns = pytest.mark.parametrize("turns", CONTRACTS)


def counter_of(cycle: int) -> int:
    """Return the SYNC counter of a cycle, whose numbers begin with 1."""
    return (cycle - 1) % 240 + 1


def node_frames(contract: Contract, node: int, counter: int, value: int) -> Frames:
    """Return the frames of a node that answer a SYNC; every sum is `value` steps."""
    table, packing = contract.table, contract.packing
    rows = np.flatnonzero((table.node == node) & (table.turn == contract.turn_of(counter)))
    out = frames(len(rows))
    out["can_id"], out["length"] = table.cob_id[rows], table.length[rows]
    sums = np.full(contract.phi.shape[0], value * packing.scale)
    out["data"][:, :8] = encode(counter, sums, table.gather[rows], packing)
    return out


class Skin:
    """A collector of two buses of two boards; each sum of cycle n is n steps, so a valid block tells its cycles."""

    def __init__(self, turns: int = 1, collector: Collector | None = None) -> None:
        self.contract = CONTRACTS[turns]
        self.collector = collector or Collector(self.contract)
        self.collector.trust(slice(None), proven=True)
        self.cycle = 0

    def begin(self) -> int:
        """Open the next cycle."""
        self.cycle += 1
        self.collector.open(counter_of(self.cycle))
        return self.cycle

    def answers(self, cycle: int, *nodes: int) -> Frames:
        return np.concatenate(
            [frames(0), *(node_frames(self.contract, each, counter_of(cycle), cycle) for each in nodes)]
        )

    def take(self, bus: int, *parts: Frames) -> None:
        self.collector.take(bus, np.concatenate([frames(0), *parts]), 0)

    def close(self, cycle: int) -> list[bool]:
        """Close a cycle; check its valid sums; return which blocks are valid."""
        return self.check(cycle, self.collector.close(counter_of(cycle)))

    def check(self, cycle: int, gathered: Gathered) -> list[bool]:
        table, contract = self.contract.table, self.contract
        for row in range(len(table.node)):
            block = int(table.node[row])
            if gathered.valid[block]:
                age = (contract.turn_of(counter_of(cycle)) - int(table.turn[row])) % contract.turns
                got = gathered.sums[table.gather[row]] // contract.packing.scale
                assert (got == cycle - age).all(), f"block {block} of cycle {cycle} has sums of {got}"
        return gathered.valid.tolist()

    def whole(self) -> list[bool]:
        """Go through a cycle in which nothing is wrong."""
        cycle = self.begin()
        self.take(0, self.answers(cycle, 0, 1))
        self.take(1, self.answers(cycle, 2, 3))
        return self.close(cycle)

    def run(self, cycles: int, *nodes: int) -> list[bool]:
        """Go through cycles in which some nodes answer; return which blocks are valid in the last."""
        for _ in range(cycles):
            cycle = self.begin()
            for bus in (0, 1):
                self.take(bus, self.answers(cycle, *(each for each in nodes if each // 2 == bus)))
            last = self.close(cycle)
        return last


@turns
def test_a_block_is_valid_once_each_turn_has_come(turns: int) -> None:
    skin = Skin(turns)
    assert [skin.whole() for _ in range(3)] == [[turns == 1] * 4, [True] * 4, [True] * 4]


@turns
def test_a_node_that_misses_a_sync_is_not_valid_while_its_sums_are_missing(turns: int) -> None:
    skin = Skin(turns)
    skin.run(2, 0, 1, 2, 3)
    assert skin.run(1, 1, 2, 3) == [False, True, True, True]
    after = [skin.whole()[0] for _ in range(3)]
    assert after == ([True] * 3 if turns == 1 else [False, True, True])


@turns
def test_frames_count_in_the_cycle_that_they_name_also_after_the_next_sync(turns: int) -> None:
    skin = Skin(turns)
    skin.run(2, 0, 1, 2, 3)
    old, new = skin.begin(), skin.begin()
    skin.take(1, skin.answers(old, 2, 3), skin.answers(new, 2, 3))
    skin.take(0, skin.answers(new, 1), skin.answers(old, 0, 1), skin.answers(new, 0))
    assert skin.close(old) == [True] * 4
    assert skin.close(new) == [True] * 4
    assert skin.collector.counts.late == 0


def test_a_frame_of_the_next_cycle_tells_that_the_bus_has_ended_the_cycle_before() -> None:
    skin = Skin()
    skin.run(2, 0, 1, 2, 3)
    old, new = skin.begin(), skin.begin()
    skin.take(1, skin.answers(old, 2, 3))
    skin.take(0, skin.answers(old, 0))
    assert not skin.collector.is_settled(counter_of(old))
    skin.take(0, skin.answers(new, 0))
    assert skin.collector.is_settled(counter_of(old))
    skin.take(0, skin.answers(new, 1))
    assert not skin.collector.is_settled(counter_of(new))
    assert skin.close(old) == [True, False, True, True]


@pytest.mark.parametrize("late", [2, 3, 120, 238])
def test_frames_of_closed_cycles_are_late_and_not_used(late: int) -> None:
    skin = Skin()
    skin.run(late, 0, 1, 2, 3)
    cycle = skin.begin()
    skin.take(0, skin.answers(cycle - late, 0), skin.answers(cycle, 1))
    skin.take(1, skin.answers(cycle, 2, 3))
    assert skin.close(cycle) == [False, True, True, True]
    assert (skin.collector.counts.late, skin.collector.late_of_node.tolist()) == (2, [2, 0, 0, 0])


@pytest.mark.parametrize("counter", [0, 241, 255])
def test_a_counter_that_no_sync_has_makes_a_frame_malformed(counter: int) -> None:
    skin = Skin()
    cycle = skin.begin()
    wrong = skin.answers(cycle, 0)
    wrong["data"][:, 0] = counter
    skin.take(0, wrong)
    assert skin.collector.counts.malformed == 2


@pytest.mark.parametrize("silent", [1, 100, 119])
def test_after_a_short_silence_the_first_answer_counts(silent: int) -> None:
    skin = Skin()
    skin.run(1, 0, 1, 2, 3)
    skin.run(silent, 1, 2, 3)
    assert skin.whole() == [True] * 4


@turns
def test_after_120_silent_cycles_two_cycles_prove_that_a_node_is_not_a_round_of_the_counter_late(turns: int) -> None:
    skin = Skin(turns)
    skin.run(2, 0, 1, 2, 3)
    skin.run(120, 1, 2, 3)
    after = [skin.whole()[0] for _ in range(6)]
    assert after == ([False, False, True, True, True, True] if turns == 1 else [False] * 5 + [True])


@pytest.mark.parametrize("held", [1, 2, 10])
@pytest.mark.parametrize("hung", [240, 241])
def test_what_a_board_held_back_for_a_round_of_the_counter_is_not_used(hung: int, held: int) -> None:
    """The board hangs, holds back its first answers, and sends all of them when it goes on, across a SYNC."""
    for first in range(held + 1):
        skin = Skin()
        skin.run(1, 0, 1, 2, 3)
        begun = skin.cycle + 1
        skin.run(hung, 1, 2, 3)
        waiting = [skin.answers(begun + each, 0) for each in range(held)]
        cycle = skin.begin()
        skin.take(0, *waiting[:first], skin.answers(cycle, 1))
        skin.take(1, skin.answers(cycle, 2, 3))
        assert skin.close(cycle) == [False, True, True, True]
        cycle = skin.begin()
        skin.take(0, *waiting[first:], skin.answers(cycle, 0, 1))
        skin.take(1, skin.answers(cycle, 2, 3))
        assert skin.close(cycle) == [False, True, True, True]
        assert skin.run(4, 0, 1, 2, 3) == [True] * 4


def test_a_stack_that_counts_syncs_may_exchange_its_turns_though_its_frames_come_last() -> None:
    skin = Skin(2)
    skin.run(4, 0, 1, 2, 3)
    table = skin.contract.table
    for _ in range(6):
        cycle = skin.begin()
        exchanged = node_frames(skin.contract, 0, counter_of(cycle + 1), cycle)
        exchanged["data"][:, 0] = counter_of(cycle)
        skin.take(0, skin.answers(cycle, 1))
        skin.take(1, skin.answers(cycle, 2, 3))
        closes_early = skin.collector.is_settled(counter_of(cycle))
        if not closes_early:
            skin.take(0, exchanged)
        is_settled = skin.collector.is_settled(counter_of(cycle))
        gathered = skin.collector.close(counter_of(cycle))
        if closes_early:
            skin.take(0, exchanged)
    assert is_settled
    assert gathered.complete
    missing = skin.collector.missing_of_node[0]
    sums = gathered.sums[table.gather[table.node == 0]] // 4
    assert sorted(sums[:, 0].tolist()) == [cycle - 1, cycle]
    skin.whole()
    assert missing <= 2


def test_a_sync_that_was_never_on_the_bus_costs_its_cycle_alone() -> None:
    skin = Skin()
    skin.whole()
    lost, new = skin.begin(), skin.begin()
    skin.take(1, skin.answers(lost, 2, 3), skin.answers(new, 2, 3))
    skin.take(0, skin.answers(new, 0, 1))
    assert skin.close(lost) == [False, False, True, True]
    assert skin.close(new) == [True] * 4


def test_frames_that_come_twice_with_equal_data_are_valid_and_with_other_data_are_not() -> None:
    skin = Skin()
    cycle = skin.begin()
    other = skin.answers(cycle, 1)
    other["data"][0, 1] ^= 1
    skin.take(0, skin.answers(cycle, 0, 1), skin.answers(cycle, 0), other)
    skin.take(1, skin.answers(cycle, 2, 3))
    assert skin.close(cycle) == [True, False, True, True]
    assert skin.collector.counts.duplicate == 4
    assert skin.whole() == [True] * 4


def test_a_foreign_sync_costs_the_open_cycle_and_the_one_of_its_counter_on_its_bus() -> None:
    skin = Skin()
    skin.whole()
    cycle = skin.begin()
    skin.take(0, skin.answers(cycle, 0), sync_frame(counter_of(cycle + 2)), skin.answers(cycle, 1))
    skin.take(1, skin.answers(cycle, 2, 3))
    assert skin.close(cycle) == [False, False, True, True]
    assert skin.whole() == [True] * 4
    assert skin.whole() == [False, False, True, True]
    assert all(skin.whole() == [True] * 4 for _ in range(240))


def test_the_counter_of_a_foreign_sync_behind_is_forgotten_before_it_comes_round() -> None:
    skin = Skin()
    skin.run(3, 0, 1, 2, 3)
    cycle = skin.begin()
    skin.take(0, sync_frame(counter_of(cycle - 2)))
    skin.close(cycle)
    assert all(skin.whole() == [True] * 4 for _ in range(240))


def test_a_sync_of_the_gateway_that_is_on_the_bus_twice_costs_its_cycle() -> None:
    skin = Skin()
    skin.whole()
    cycle = skin.begin()
    echo = sync_frame(counter_of(cycle))
    echo["flags"], echo["time_ns"] = ECHO, 1_000_000
    skin.take(0, echo, skin.answers(cycle, 0, 1))
    skin.take(0, echo)
    skin.take(1, skin.answers(cycle, 2, 3))
    assert skin.close(cycle) == [False, False, True, True]
    assert skin.whole() == [True] * 4


def test_frames_lost_by_the_gateway_itself_may_be_a_foreign_sync_and_cost_the_open_cycles() -> None:
    gathering = CycleGathering(CONTRACTS[1])
    skin = Skin(1, gathering.collector)
    skin.whole()
    cycle = skin.begin()
    health = Health()
    health.look(State.ACTIVE, 1, 0, tells_loss=False)
    gathering.take(0, skin.answers(cycle, 0, 1), health, 0.0)
    skin.take(1, skin.answers(cycle, 2, 3))
    assert skin.close(cycle) == [False, False, True, True]
    assert skin.whole() == [True] * 4


# Whatever happens


@dataclass
class Board:
    """A board that answers SYNCs, and may hang, miss SYNCs and be late.

    Attributes
    ----------
    until : int
        The cycle in which the board goes on.
    is_deaf : bool
        Whether it misses the SYNCs while it hangs.
    room : int
        Answers that it can hold back; the oldest stay.
    lag : int
        Answers that it always holds back.
    """

    until: int = 0
    is_deaf: bool = False
    room: int = 1000
    lag: int = 0
    waiting: deque[Frames] = field(default_factory=deque)

    def answer(self, cycle: int, answer: Frames) -> list[Frames]:
        """Take a SYNC; return what the board sends."""
        hangs = cycle < self.until
        if not (hangs and self.is_deaf) and len(self.waiting) < self.room + self.lag:
            self.waiting.append(answer)
        return [] if hangs else [self.waiting.popleft() for _ in range(max(0, len(self.waiting) - self.lag))]


class Disturbed(Skin):
    """Boards and the ways of their frames, disturbed at random; frames of one bus keep their order."""

    def __init__(self, turns: int, seed: int) -> None:
        super().__init__(turns)
        self.random = np.random.default_rng(seed)
        self.boards = [Board() for _ in range(4)]
        #: By bus: until which cycle an interface holds back what it has received.
        self.held_until = [0, 0]
        self.held: list[list[Frames]] = [[], []]
        #: By bus: counters of SYNCs of another master in this cycle; and part of the SYNCs and frames that are lost.
        self.foreign: list[list[int]] = [[], []]
        self.loses = [0.0, 0.0]
        self._open: deque[int] = deque()

    def disturb(self) -> None:
        random, bus = self.random, int(self.random.integers(2))
        board = self.boards[2 * bus + int(random.integers(2))]
        long = int(random.choice([1, 2, 3, 5, 30, 119, 120, 121, 122, 237, 238, 239, 240, 241, 242, 300, 480]))
        match int(random.integers(8)):
            case 0 | 1:
                board.until = self.cycle + 1 + long
                board.is_deaf, board.room = bool(random.integers(2)), int(random.choice([1, 2, 3, 1000]))
            case 2:
                self.held_until[bus] = self.cycle + 1 + long
            case 3:
                board.lag = int(random.choice([0, 0, 1]))
            case 4:
                self.foreign[bus].append(int(random.integers(0, 256)) if random.integers(2) else self._near())
            case 5:
                self.loses[bus] = float(random.choice([0.0, 0.05, 0.5]))
            case 6:
                self.loses[bus] = 0.0
            case _:
                pass

    def _near(self) -> int:
        return counter_of(max(1, self.cycle + int(self.random.integers(-3, 4))))

    def step(self) -> None:
        """Go through a period: SYNC, answers across it, and the cycles that end."""
        self.cycle += 1
        if len(self._open) == 2:
            self._end()
        self.collector.open(counter_of(self.cycle))
        self._open.append(self.cycle)
        for bus in self.random.permutation(2).tolist():
            self._pass(bus)
        while self._open and self.collector.is_settled(counter_of(self._open[0])):
            self._end()

    def _end(self) -> None:
        cycle = self._open.popleft()
        self.last = self.close(cycle)

    def _pass(self, bus: int) -> None:
        came = []
        for node in (2 * bus, 2 * bus + 1):
            board = self.boards[node]
            for counter in self.foreign[bus]:
                asked = node_frames(self.contract, node, counter, OTHER) if 1 <= counter <= 240 else frames(0)
                came += [frame(SYNC_COB_ID, bytes((counter,))), *board.answer(self.cycle, asked)]
            if self.random.random() >= self.loses[bus]:
                came += board.answer(self.cycle, self.answers(self.cycle, node))
        self.foreign[bus].clear()
        kept = [each for each in came if self.random.random() >= self.loses[bus] or (each["can_id"] == 0x80).any()]
        again = [each for each in kept if self.random.random() < 0.02 and not (each["can_id"] == 0x80).any()]
        self.held[bus] += kept + again
        if self.cycle >= self.held_until[bus]:
            waiting, self.held[bus] = self.held[bus], []
            # What has waited may come across the next SYNC.
            if len(waiting) > 4 and self.random.integers(2):
                cut = int(self.random.integers(len(waiting)))
                waiting, self.held[bus] = waiting[:cut], waiting[cut:]
            self.take(bus, *waiting)


@turns
def test_whatever_happens_no_valid_block_is_wrong_and_the_skin_becomes_whole(turns: int) -> None:
    @settings(RANDOM, max_examples=max(4, DISTURBANCES // STEPS))
    @given(st.integers(0, 2**32 - 1))
    def run(seed: int) -> None:
        skin = Disturbed(turns, seed)
        for _ in range(STEPS):
            skin.disturb()
            for _ in range(int(skin.random.integers(1, 12))):
                skin.step()
        skin.loses = [0.0, 0.0]
        for board in skin.boards:
            board.until, board.lag = 0, 0
        skin.held_until = [0, 0]
        for _ in range(300):
            skin.step()
        assert skin.last == [True] * 4

    run()


def test_first_data_comes_with_the_first_sync_after_the_start_command() -> None:
    world = World(CONTRACTS[1])
    assert valid(until_measured(world)).all()
    world.segments[0].boot(world.now_s)
    world.run(0.02)
    while not all(each.in_use for each in world.gateway.masters[0].nodes.values()):
        world.step()  # the start commands go out with the last proof
    world.until_sync()
    first = until_measured(world)
    assert valid(first).all()
    assert not any(world.wrong_blocks(each) for each in world.measured)


def until_measured(world: World):  # noqa: ANN201 - a measurement
    count = len(world.measured)
    while len(world.measured) == count:
        world.step()
    return world.measured[-1]


def test_skipped_periods_cost_nothing() -> None:
    world = World(CONTRACTS[1])
    world.until_whole(2.0)
    world.now_s += 3 * PERIOD_S
    came = world.run(10 * PERIOD_S)
    assert world.gateway.sync.skipped > 0
    assert all(valid(each).all() and not world.wrong_blocks(each) for each in came)
