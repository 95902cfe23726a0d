"""Frames in time, late, repeated, lost or of another master: each counts once, in the cycle that it names."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.link import State
from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract, sync_frame
from dbc.frame import ECHO, ERROR, EXTENDED, FD, FRAME, REMOTE, Frames, frames
from gateway.batch import Batch, batch_of
from gateway.collector import Collector, Gathered
from gateway.cycle_gathering import CycleGathering
from gateway.gathering import Health
from skin.sync_counter import next_counter
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


def echo(cycle: int, time_ns: int = 0) -> Frames:
    return frame(SYNC_COB_ID, bytes((counter_of(cycle),)), ECHO, time_ns=time_ns)


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

    def take(self, bus: int, *parts: Frames, stamp_error_ns: int | None = 0) -> None:
        self.collector.take(self.batch(bus, *parts), stamp_error_ns)

    def batch(self, bus: int, *parts: Frames) -> Batch:
        return batch_of(np.concatenate([frames(0), *parts]), bus, self.contract.table)

    def close(self, cycle: int) -> str:
        """Close a cycle; check its valid sums; return which blocks are valid, as 0 and 1."""
        gathered = self.collector.close(counter_of(cycle))
        table, contract = self.contract.table, self.contract
        for row in range(len(table.node)):
            block = int(table.node[row])
            if gathered.valid[block]:
                age = (contract.turn_of(counter_of(cycle)) - int(table.turn[row])) % contract.turns
                got = gathered.sums[table.gather[row]] // contract.packing.scale
                assert (got == cycle - age).all(), f"block {block} of cycle {cycle} has sums of {got}"
        return "".join(map(str, gathered.valid.astype(int)))

    def whole(self) -> str:
        """Go through a cycle in which nothing is wrong."""
        (told,) = self.run("0123")
        return told

    def run(self, *answering: str) -> list[str]:
        """Go through a cycle for each text, which names the nodes that answer; return which blocks are valid."""
        told = []
        for nodes in answering:
            cycle = self.begin()
            for bus in (0, 1):
                self.take(bus, self.answers(cycle, *(int(each) for each in nodes if int(each) // 2 == bus)))
            told.append(self.close(cycle))
        return told

    def cycle_of(self, *bus_0: Frames) -> str:
        """Go through a cycle in which the second bus is whole, and the first carries other frames."""
        self.take(0, *bus_0)
        self.take(1, self.answers(self.cycle, 2, 3))
        return self.close(self.cycle)


@turns
def test_a_block_is_valid_when_each_turn_has_come_and_no_longer_when_its_node_misses_a_sync(turns: int) -> None:
    skin = Skin(turns)
    assert skin.run(*["0123"] * 3) == [("1111", "0000")[turns - 1], "1111", "1111"]
    assert skin.run("123") == ["0111"]
    assert skin.run(*["0123"] * 3) == [("1111", "0111")[turns - 1], "1111", "1111"]


@turns
def test_frames_count_in_the_cycle_that_they_name_also_after_the_next_sync(turns: int) -> None:
    skin = Skin(turns)
    skin.run("0123", "0123")
    old, new = skin.begin(), skin.begin()
    skin.take(1, skin.answers(old, 2, 3), skin.answers(new, 2, 3))
    skin.take(0, skin.answers(new, 1), skin.answers(old, 0, 1), skin.answers(new, 0))
    assert [skin.close(old), skin.close(new), skin.collector.counts.late] == ["1111", "1111", 0]


def test_a_frame_of_the_next_cycle_tells_that_the_bus_has_ended_the_cycle_before() -> None:
    skin = Skin()
    skin.whole()
    old, new = skin.begin(), skin.begin()
    skin.take(1, skin.answers(old, 2, 3))
    for came, settled in ((skin.answers(old, 0), (False, False)), (skin.answers(new, 0), (True, False))):
        skin.take(0, came)
        assert (skin.collector.is_settled(counter_of(old)), skin.collector.is_settled(counter_of(new))) == settled
    skin.take(0, skin.answers(new, 1))
    assert not skin.collector.is_settled(counter_of(new))
    assert skin.close(old) == "1011"


def test_a_cycle_waits_for_expected_nodes_only() -> None:
    skin = Skin()
    skin.collector.expected[0] = False
    cycle = skin.begin()
    skin.take(1, skin.answers(cycle, 2, 3))
    skin.take(0, skin.answers(cycle, 0))
    assert not skin.collector.is_settled(cycle)  # the frames of node 0 count for nobody else
    skin.take(0, skin.answers(cycle, 1))
    assert skin.collector.is_settled(cycle)
    assert skin.close(cycle) == "1111"


def test_proof_counts_from_the_next_sync_on_and_a_doubt_from_the_cycle_under_way() -> None:
    skin = Skin()
    skin.collector.trust(slice(0, 2), proven=False)
    skin.begin()
    skin.collector.trust(slice(0, 1), proven=True)
    skin.collector.trust(slice(3, 4), proven=False)
    assert skin.cycle_of(skin.answers(skin.cycle, 0, 1)) == "0010"
    assert skin.whole() == "1010"


def test_a_sync_that_was_never_on_the_bus_costs_its_cycle_alone() -> None:
    skin = Skin()
    skin.whole()
    lost, new = skin.begin(), skin.begin()
    skin.take(1, skin.answers(lost, 2, 3), skin.answers(new, 2, 3))
    skin.take(0, skin.answers(new, 0, 1))
    assert [skin.close(lost), skin.close(new)] == ["0011", "1111"]


def changed(sent: Frames, **values: int) -> Frames:
    """Return a burst whose first frame has other `flags`, `length` or `data`."""
    copy = sent.copy()
    for key, value in values.items():
        if key == "data":
            copy["data"][0, 1] ^= value
        else:
            copy[key][0] = value
    return copy


#: What befalls the frames of node 0 in cycle 10 before those of node 1 come; and the kind that counts them.
LOSSES: dict[str, tuple[Callable[[Skin, Frames], Frames], str, int]] = {
    "lost": (lambda _, mine: mine[1:], "missing", 1),
    "of a cycle that is closed": (lambda skin, _: skin.answers(8, 0), "late", 2),
    "of a cycle long closed": (lambda skin, _: skin.answers(-228, 0), "late", 2),
    "without counter": (lambda _, mine: _named(mine, 0), "malformed", 2),
    "with a counter that no SYNC has": (lambda _, mine: _named(mine, 241), "malformed", 2),
    "shorter": (lambda _, mine: changed(mine, length=mine["length"][0] - 1), "malformed", 1),
    "longer": (lambda _, mine: changed(mine, length=12), "malformed", 1),
    "extended": (lambda _, mine: changed(mine, flags=EXTENDED), "foreign", 1),
    "remote": (lambda _, mine: changed(mine, flags=REMOTE), "foreign", 1),
    "of CAN FD": (lambda _, mine: changed(mine, flags=FD), "foreign", 1),
    "given back unsent": (lambda _, mine: changed(mine, flags=ECHO | ERROR), "missing", 1),
    "its copy differs": (lambda _, mine: np.concatenate((mine, changed(mine, data=1)[:1])), "duplicate", 1),
}


def _named(mine: Frames, counter: int) -> Frames:
    copy = mine.copy()
    copy["data"][:, 0] = counter
    return copy


@pytest.mark.parametrize("loss", LOSSES)
def test_whatever_befalls_a_frame_its_block_alone_is_invalid_and_the_next_cycle_is_whole(loss: str) -> None:
    skin = Skin()
    skin.run(*["0123"] * 9)
    befalls, kind, count = LOSSES[loss]
    cycle = skin.begin()
    told = skin.cycle_of(echo(cycle), befalls(skin, skin.answers(cycle, 0)), skin.answers(cycle, 1))
    assert told == "0111"
    assert getattr(skin.collector.counts, kind) == count
    assert skin.collector.late_of_node.tolist() == [2 * (kind == "late"), 0, 0, 0]
    assert skin.run("0123", "0123") == ["1111", "1111"]


def test_frames_that_come_twice_with_equal_data_are_valid() -> None:
    skin = Skin()
    cycle = skin.begin()
    assert skin.cycle_of(skin.answers(cycle, 0, 1), skin.answers(cycle, 0)) == "1111"
    assert skin.collector.counts.duplicate == 2


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_frames_are_counted_and_never_raise(seed: int) -> None:
    random, skin = np.random.default_rng(seed), Skin()
    counter, given_frames = 1, 0
    for _ in range(6):
        skin.collector.open(counter)
        for bus in range(2):
            wild = np.frombuffer(random.bytes(50 * FRAME.itemsize), FRAME).copy()
            wild["can_id"] = random.integers(0, 0x900, 50)
            wild["flags"] &= np.uint8(random.choice([0, ERROR | ECHO, 0xFF]))
            mine = skin.answers(counter, 2 * bus, 2 * bus + 1)
            mixed = np.concatenate((echo(counter), mine, wild, mine[:3]))
            mixed[1:] = random.permutation(mixed[1:])
            given_frames += int((mixed["flags"] & (ERROR | ECHO) == 0).sum())
            skin.take(bus, mixed)
        skin.collector.close(counter)
        counter = next_counter(counter)
    counts = skin.collector.counts
    assert counts.received + counts.foreign == given_frames
    assert counts.accepted + counts.missing == 6 * len(skin.contract.table.node)


# Silence, and what may be of the round of the counter before


@pytest.mark.parametrize(("silent", "turns", "first"), [(1, 1, 0), (119, 1, 0), (120, 1, 2), (120, 2, 5)])
def test_after_120_silent_cycles_two_cycles_prove_that_a_node_is_not_a_round_of_the_counter_late(
    silent: int, turns: int, first: int
) -> None:
    skin = Skin(turns)
    skin.run(*["0123"] * 2, *["123"] * silent)
    assert "".join(told[0] for told in skin.run(*["0123"] * 7)) == "0" * first + "1" * (7 - first)


@pytest.mark.parametrize("came", [0, 2, 3])
def test_a_doubtful_node_proves_nothing_unless_exactly_one_frame_comes_after_each_sync(came: int) -> None:
    """Of each identifier: what a board has held back comes at once, and not one for each SYNC."""
    skin = Skin()
    skin.run("0123", *["123"] * 120)
    for _ in range(4):
        cycle = skin.begin()
        mine = skin.answers(cycle, 0)
        assert skin.cycle_of(*[mine] * came, skin.answers(cycle, 1)) == "0111"
    assert [told[0] for told in skin.run(*["0123"] * 3)] == ["0", "0", "1"]


@pytest.mark.parametrize("held", [1, 2, 10])
@pytest.mark.parametrize("hung", [240, 241])
def test_what_a_board_held_back_for_a_round_of_the_counter_is_not_used(hung: int, held: int) -> None:
    """The board hangs, holds back its first answers, and sends all of them when it goes on, across a SYNC."""
    for first in range(held + 1):
        skin = Skin()
        skin.whole()
        begun = skin.cycle + 1
        skin.run(*["123"] * hung)
        waiting = [skin.answers(begun + each, 0) for each in range(held)]
        cycle = skin.begin()
        assert skin.cycle_of(*waiting[:first], skin.answers(cycle, 1)) == "0111"
        cycle = skin.begin()
        assert skin.cycle_of(*waiting[first:], skin.answers(cycle, 0, 1)) == "0111"
        assert skin.run(*["0123"] * 4)[-1] == "1111"


def test_a_stack_that_counts_syncs_may_exchange_its_turns_though_its_frames_come_last() -> None:
    skin = Skin(2)
    skin.run(*["0123"] * 4)
    table = skin.contract.table
    for _ in range(6):
        cycle = skin.begin()
        exchanged = _named(node_frames(skin.contract, 0, counter_of(cycle + 1), cycle), counter_of(cycle))
        skin.take(0, skin.answers(cycle, 1))
        skin.take(1, skin.answers(cycle, 2, 3))
        closes_early = skin.collector.is_settled(counter_of(cycle))
        if not closes_early:
            skin.take(0, exchanged)
        is_settled = skin.collector.is_settled(counter_of(cycle))
        gathered: Gathered = skin.collector.close(counter_of(cycle))
        if closes_early:
            skin.take(0, exchanged)
    assert is_settled
    assert gathered.complete
    sums = gathered.sums[table.gather[table.node == 0]] // 4
    assert sorted(sums[:, 0].tolist()) == [cycle - 1, cycle]
    assert skin.collector.missing_of_node[0] <= 2


# SYNCs of others, SYNCs that come twice, and the instant of a SYNC


def test_a_foreign_sync_costs_the_open_cycle_and_the_one_of_its_counter_on_its_bus() -> None:
    skin = Skin()
    skin.whole()
    cycle = skin.begin()
    ahead, behind = sync_frame(counter_of(cycle + 2)), sync_frame(counter_of(cycle - 1))
    assert skin.cycle_of(skin.answers(cycle, 0), ahead, behind, skin.answers(cycle, 1)) == "0011"
    assert skin.run("0123", "0123") == ["1111", "0011"]
    assert set(skin.run(*["0123"] * 240)) == {"1111"}


def test_a_sync_of_the_gateway_that_is_on_the_bus_twice_costs_its_cycle() -> None:
    skin = Skin()
    skin.whole()
    cycle = skin.begin()
    mine = echo(cycle, 1_000_000)
    assert skin.cycle_of(mine, skin.answers(cycle, 0, 1), mine) == "0011"
    assert skin.whole() == "1111"


def test_frames_lost_by_the_gateway_itself_may_be_a_foreign_sync_and_cost_the_open_cycles() -> None:
    gathering = CycleGathering(CONTRACTS[1])
    skin = Skin(1, gathering.collector)
    skin.whole()
    cycle = skin.begin()
    health = Health()
    health.look(State.ACTIVE, 1, 0, tells_loss=False)
    gathering.take(skin.batch(0, skin.answers(cycle, 0, 1)), health, 0.0)
    assert skin.cycle_of() == "0011"
    assert skin.whole() == "1111"


@pytest.mark.parametrize(("stamp_error_ns", "error_ns"), [(1_000, 701_000), (None, 900_000)])
def test_the_instant_of_a_sync_is_known_by_its_echo_or_without_stamps_by_the_first_answer(
    stamp_error_ns: int | None, error_ns: int
) -> None:
    """The echo comes 0.7 ms after the SYNC was sent, answers 0.9 ms and 1 ms after that; SYNC takes 52 us."""
    skin = Skin()
    skin.collector.open(1, 10_000_000, 10_000_000)
    sent = skin.answers(1, 0)
    sent["time_ns"] = 10_900_000, 11_000_000
    skin.take(0, echo(1, 10_700_000), sent, stamp_error_ns=stamp_error_ns)
    assert skin.collector.close(1).times.error_ns == error_ns - 52_000


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
                near = counter_of(max(1, self.cycle + int(random.integers(-3, 4))))
                self.foreign[bus].append(int(random.integers(0, 256)) if random.integers(2) else near)
            case 5:
                self.loses[bus] = float(random.choice([0.0, 0.05, 0.5]))
            case 6:
                self.loses[bus] = 0.0
            case _:
                pass

    def step(self) -> None:
        """Go through a period: SYNC, answers across it, and the cycles that end."""
        if len(self._open) == 2:
            self._end()
        self._open.append(self.begin())
        for bus in self.random.permutation(2).tolist():
            self._pass(bus)
        while self._open and self.collector.is_settled(counter_of(self._open[0])):
            self._end()

    def _end(self) -> None:
        self.last = self.close(self._open.popleft())

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
        assert skin.last == "1111"

    run()


def test_first_data_comes_with_the_first_sync_after_the_start_command() -> None:
    world = World(CONTRACTS[1])
    world.until(lambda: world.measured)
    assert valid(world.measured[-1]).all()
    world.segments[0].boot(world.now_s)
    world.run(0.02)
    world.until(lambda: all(each.in_use for each in world.gateway.masters[0].nodes.values()))
    world.until_sync()
    count = len(world.measured)
    world.until(lambda: len(world.measured) > count)
    assert valid(world.measured[-1]).all()
    assert not any(world.wrong_blocks(each) for each in world.measured)


def test_skipped_periods_cost_nothing() -> None:
    world = World(CONTRACTS[1])
    world.until_whole(2.0)
    world.now_s += 3 * PERIOD_S
    came = world.run(10 * PERIOD_S)
    assert world.gateway.sync.skipped > 0
    assert all(valid(each).all() and not world.wrong_blocks(each) for each in came)
