"""What each identity of cycles detects and what it cannot: the claims of docs/bus.md, one test for each."""

import numpy as np
import pytest

from bus.link import State
from bus.python_can import PythonCanLink
from canskin.errors import InputError
from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.frame import ECHO, Frames, frames
from gateway.collector import Collector
from gateway.command import require_order
from gateway.cycle_gathering import CycleGathering
from gateway.gathering import Health
from gateway.outstanding import QUIET_NS
from tests.gateway.helpers import PERIOD_S, World, two_states, until_sync, valid
from tests.layouts import IDENTITIES, small_contract

PERIOD_NS = round(PERIOD_S * 1e9)
SYNC_NS = 50_000
ANSWER_NS = 1_000_000
CONTRACTS = {identity: small_contract(identity=identity) for identity in IDENTITIES}

both = pytest.mark.parametrize("identity", IDENTITIES)


class Bus:
    """A collector whose second bus is always in order; every sum of cycle n is n, so a valid block tells its cycle."""

    def __init__(self, identity: str, collector: Collector | None = None, *, answer_ns: int = ANSWER_NS) -> None:
        self._answer_ns = answer_ns
        self.contract = CONTRACTS[identity]
        self.collector = collector or Collector(self.contract)
        self.collector.trust(slice(None), proven=True)
        self.counter = 0

    def frames_of(self, cycle: int, *blocks: int) -> Frames:
        """Return the frames of blocks 0 and 1, on the first bus, with the sums of a cycle."""
        return self._frames(0, cycle)[np.repeat([0 in blocks, 1 in blocks], 2)]

    def sync(self, *, late_ns: int = 0) -> Frames:
        """Return the echo of the newest SYNC."""
        echo = self.contract.sync(self.counter)
        echo["flags"], echo["time_ns"] = ECHO, self.counter * PERIOD_NS + SYNC_NS + late_ns
        return echo

    def begin(self) -> int:
        """Open the next cycle, with all frames of the second bus."""
        self.counter += 1
        self.collector.open(self.counter, self.counter * PERIOD_NS)
        self.collector.take(1, np.concatenate([self.sync(), self._frames(1, self.counter)]), 0)
        return self.counter

    def take(self, *parts: Frames) -> None:
        arrived = np.concatenate(parts)
        arrived["time_ns"][arrived["time_ns"] == 0] = self.counter * PERIOD_NS + self._answer_ns
        self.collector.take(0, arrived, 0)

    def valid(self, cycle: int) -> list[bool]:
        """Close a cycle; check its valid sums; return whether the blocks of the first bus are valid."""
        gathered = self.collector.close(cycle)
        for block in np.flatnonzero(gathered.valid):
            assert (gathered.sums[self.contract.phi.block_of_sum == block] == cycle).all(), f"block {block} is wrong"
        assert gathered.valid[2:].all()
        return gathered.valid[:2].tolist()

    def whole(self) -> list[bool]:
        """Go through one cycle in which nothing is wrong."""
        cycle = self.begin()
        self.take(self.sync(), self.frames_of(cycle, 0, 1))
        return self.valid(cycle)

    def _frames(self, bus: int, cycle: int) -> Frames:
        table, phi = self.contract.table, self.contract.phi
        rows = np.flatnonzero((table.bus == bus) & (table.phase == self.contract.phase_of(cycle)))
        out = frames(len(rows))
        out["can_id"], out["length"] = table.cob_id[rows], table.length[rows]
        sums = np.full(phi.shape[0], cycle)
        out["data"][:, :8] = encode(sums, table.gather[rows], self.contract.packing)
        return out


@both
def test_node_that_missed_a_sync_is_not_valid_in_this_cycle_and_with_window_in_the_next(identity: str) -> None:
    bus = Bus(identity)
    assert bus.whole() == [True, True]
    cycle = bus.begin()
    bus.take(bus.sync(), bus.frames_of(cycle, 1))
    assert bus.valid(cycle) == [False, True]
    assert bus.whole() == [identity == "alternating", True]
    assert bus.whole() == [True, True]


@both
def test_late_frames_beside_the_answer_to_the_new_sync_are_not_used(identity: str) -> None:
    bus = Bus(identity)
    bus.whole()
    old = bus.begin()
    bus.take(bus.sync(), bus.frames_of(old, 1))
    new = bus.begin()
    bus.take(bus.sync(), bus.frames_of(old, 0), bus.frames_of(new, 1))
    if identity == "window":
        assert bus.collector.is_settled(new)  # the late frames pass for the answer: the block must not be valid
    bus.take(bus.frames_of(new, 0))
    assert bus.valid(old) == [False, True]
    assert bus.valid(new) == [identity == "alternating", True]
    assert bus.whole() == [True, True]


@both
def test_late_frames_of_a_node_that_missed_the_new_sync_are_not_used(identity: str) -> None:
    bus = Bus(identity)
    bus.whole()
    old = bus.begin()
    bus.take(bus.sync(), bus.frames_of(old, 1))
    new = bus.begin()
    bus.take(bus.sync(), bus.frames_of(old, 0), bus.frames_of(new, 1))
    assert bus.valid(old) == bus.valid(new) == [False, True]
    assert bus.whole() == [True, True]


@both
def test_frames_on_the_bus_before_the_next_sync_count_however_late_they_are_read(identity: str) -> None:
    bus = Bus(identity)
    old = bus.begin()
    first = [bus.sync(), bus.frames_of(old, 0, 1)]
    new = bus.begin()
    bus.take(*first, bus.sync(), bus.frames_of(new, 0, 1))
    assert bus.valid(old) == bus.valid(new) == [True, True]


@both
def test_sync_that_was_never_on_the_bus_costs_its_cycle_alone(identity: str) -> None:
    bus = Bus(identity)
    bus.whole()
    lost = bus.begin()
    new = bus.begin()
    bus.take(bus.sync(), bus.frames_of(new, 0, 1))
    assert bus.valid(lost) == [False, False]
    assert bus.valid(new) == [True, True]
    assert bus.whole() == [True, True]


@both
def test_frames_that_come_twice_with_equal_data_are_valid_and_with_other_data_are_not(identity: str) -> None:
    bus = Bus(identity)
    cycle = bus.begin()
    other = bus.frames_of(cycle, 1)
    other["data"][0, 0] ^= 1
    bus.take(bus.sync(), bus.frames_of(cycle, 0, 1), bus.frames_of(cycle, 0), other)
    assert bus.valid(cycle) == [True, False]
    assert bus.whole() == [True, True]


@both
@pytest.mark.parametrize("flags", [0, ECHO], ids=["of somebody else", "of the gateway"])
def test_second_sync_in_a_cycle_costs_this_cycle_and_the_next(identity: str, flags: int) -> None:
    """Without counter, a SYNC of the gateway that comes twice may have waited for a period in the controller."""
    bus = Bus(identity)
    bus.whole()
    cycle = bus.begin()
    again = bus.sync(late_ns=PERIOD_NS // 2)
    again["flags"] = flags
    bus.take(bus.sync(), bus.frames_of(cycle, 0, 1), again, bus.frames_of(cycle, 0, 1))
    assert bus.valid(cycle) == [False, False]
    assert bus.whole() == [False, False]
    assert bus.whole() == [True, True]


@both
def test_frames_held_back_for_two_cycles_are_not_detected_if_the_node_misses_that_sync(identity: str) -> None:
    bus = Bus(identity)
    bus.whole()
    old = bus.begin()
    bus.take(bus.sync(), bus.frames_of(old, 1))
    assert bus.valid(old) == [False, True]
    bus.whole()
    cycle = bus.begin()
    bus.take(bus.sync(), bus.frames_of(old, 0), bus.frames_of(cycle, 1))
    gathered = bus.collector.close(cycle)
    assert gathered.valid.all()
    assert (gathered.sums[bus.contract.phi.block_of_sum == 0] == old).all()


@both
def test_board_that_hung_and_misses_the_syncs_on_which_it_goes_on_is_valid_when_all_has_come(
    identity: str,
) -> None:
    bus = Bus(identity)
    bus.whole()
    hung = bus.begin()
    bus.take(bus.sync(), bus.frames_of(hung, 1))
    assert bus.valid(hung) == [False, True]
    missed = bus.begin()
    bus.take(bus.sync(), bus.frames_of(missed, 1))
    assert bus.valid(missed) == [False, True]
    goes_on = bus.begin()  # in the phase of the SYNC that it answers only now
    bus.take(bus.sync(), bus.frames_of(hung, 0), bus.frames_of(goes_on, 1))
    assert bus.valid(goes_on) == [False, True]
    assert bus.whole() == [True, True]


@pytest.mark.parametrize("missed", [1, 2, 3])
@pytest.mark.parametrize("rest_ns", [QUIET_NS, 1], ids=["a rest before SYNC", "none"])
def test_with_two_phases_a_node_loses_a_cycle_more_only_after_two_missed_syncs(missed: int, rest_ns: int) -> None:
    bus = Bus("alternating", answer_ns=PERIOD_NS + SYNC_NS - rest_ns)
    bus.whole()
    for _ in range(missed):
        cycle = bus.begin()
        bus.take(bus.sync(), bus.frames_of(cycle, 1))
        assert bus.valid(cycle) == [False, True]
    after = [bus.whole()[0] for _ in range(8)]
    if missed == 1:
        assert after == [True] * 8
    elif rest_ns == QUIET_NS:
        assert after == [False] + [True] * 7
    else:
        assert after == [False] * 5 + [True] * 3


def test_old_answers_of_a_board_that_goes_on_at_the_end_of_a_cycle_do_not_end_its_debt() -> None:
    bus = Bus("window")
    bus.whole()
    hung = []
    for _ in range(2):
        hung.append(bus.begin())
        bus.take(bus.sync(), bus.frames_of(hung[-1], 1))
        assert bus.valid(hung[-1]) == [False, True]
    last = bus.begin()
    first_old = bus.frames_of(hung[0], 0)
    first_old["time_ns"] = (last + 1) * PERIOD_NS - ANSWER_NS
    bus.take(bus.sync(), bus.frames_of(last, 1), first_old)
    new = bus.begin()
    bus.take(bus.sync(), *(bus.frames_of(each, 0) for each in (hung[1], last, new)), bus.frames_of(new, 1))
    assert bus.valid(last) == bus.valid(new) == [False, True]
    assert bus.whole() == [True, True]


def take_after_a_loss(gathering: CycleGathering, arrived: Frames) -> None:
    """Take frames of a link that has dropped a frame before them."""
    health = Health()
    health.look(frames(0), State.ACTIVE, 1, 0)
    gathering.take(0, arrived, health, 0.0)


@both
def test_frames_lost_by_the_gateway_itself_cost_the_cycles_between_which_a_sync_may_be_lost(identity: str) -> None:
    """Without the echo of the second SYNC, the answers to it would pass for those to the first."""
    gathering = CycleGathering(CONTRACTS[identity])
    bus = Bus(identity, gathering.collector)
    bus.whole()
    old = bus.begin()
    bus.take(bus.sync(), bus.frames_of(old, 1))
    new = bus.begin()
    take_after_a_loss(gathering, bus.frames_of(new, 0, 1))
    assert bus.valid(old) == ([False, True] if identity == "alternating" else [False, False])
    assert bus.valid(new) == [False, False]


@both
def test_without_the_echoes_of_two_syncs_no_answer_counts_in_an_older_cycle(identity: str) -> None:
    """With two phases nothing is spoilt: the cycle of the same phase is closed before its next SYNC is sent."""
    gathering = CycleGathering(CONTRACTS[identity])
    bus = Bus(identity, gathering.collector)
    bus.whole()
    old = bus.begin()
    bus.take(bus.sync())
    lost = bus.begin()
    assert bus.valid(old) == [False, False]
    newest = bus.begin()
    take_after_a_loss(gathering, bus.frames_of(newest, 0, 1))
    assert bus.valid(lost) == bus.valid(newest) == [False, False]


def test_while_syncs_come_within_the_window_a_node_behind_stays_behind() -> None:
    """Its window (1007h) has not passed: each frame may be the answer to the SYNC before."""
    bus = Bus("window")
    bus.whole()
    first = bus.begin()
    bus.take(bus.sync(late_ns=PERIOD_NS * 45 // 100), bus.frames_of(first, 1))
    second = bus.begin()
    bus.take(bus.sync(late_ns=PERIOD_NS * 20 // 100), bus.frames_of(first, 0), bus.frames_of(second, 1))
    assert bus.valid(first) == [False, True]
    third = bus.begin()
    bus.take(bus.sync(), bus.frames_of(second, 0), bus.frames_of(third, 1))
    assert bus.valid(second) == bus.valid(third) == [False, True]
    fourth = bus.begin()
    bus.take(bus.sync(), bus.frames_of(fourth, 0, 1))
    assert bus.valid(fourth) == [False, True]
    assert bus.whole() == [True, True]


@both
def test_node_that_ignores_1007h_and_is_late_in_every_cycle_is_detected_by_alternating_identifiers_alone(
    identity: str,
) -> None:
    bus = Bus(identity)
    bus.whole()
    behind = bus.begin()
    bus.take(bus.sync(), bus.frames_of(behind, 1))
    assert bus.valid(behind) == [False, True]
    for _ in range(8):
        cycle = bus.begin()
        bus.take(bus.sync(), bus.frames_of(cycle - 1, 0), bus.frames_of(cycle, 1))
        gathered = bus.collector.close(cycle)
    assert gathered.valid[:2].tolist() == [identity == "window", True]
    assert bus.collector.take_swapped() == ([(0, True)] if identity == "alternating" else [])


@both
def test_first_data_comes_with_the_first_sync_after_the_start_command(identity: str) -> None:
    world = World(CONTRACTS[identity])
    assert valid(until_measured(world)).all()
    world.segments[0].boot(world.now_s)
    world.run(0.02)
    while not all(each.in_use for each in world.gateway.masters[0].nodes.values()):
        world.step()  # the start commands go out with the last proof
    until_sync(world)
    first = until_measured(world)
    assert valid(first).all()
    assert not any(world.wrong_blocks(each) for each in world.measured)


def until_measured(world: World):  # noqa: ANN201 - a measurement
    count = len(world.measured)
    while len(world.measured) == count:
        world.step()
    return world.measured[-1]


@both
def test_skipped_periods_cost_nothing(identity: str) -> None:
    world = World(CONTRACTS[identity])
    world.until_whole(2.0)
    world.now_s += 3 * PERIOD_S
    came = world.run(10 * PERIOD_S)
    assert world.gateway.sync.skipped > 0
    assert all(valid(each).all() and not world.wrong_blocks(each) for each in came)


@both
@pytest.mark.parametrize("seed", range(5))
def test_whatever_syncs_nodes_miss_every_valid_block_is_of_its_cycle(identity: str, seed: int) -> None:
    world = World(CONTRACTS[identity])
    world.until_whole(2.0)
    draw = np.random.default_rng(seed)
    wire = world.wires[0]
    wire.loses = lambda end, each: end is wire.nodes and each["can_id"] == SYNC_COB_ID and draw.random() < 0.3
    came = world.run(3.0)
    assert not any(world.wrong_blocks(each) for each in came)
    part = np.mean([valid(each)[:2].all() for each in came])
    assert 0.2 < part < 0.9
    wire.loses = None
    world.until_whole(1.0)


def test_only_nodes_with_two_states_need_an_interface_that_keeps_the_order() -> None:
    link = PythonCanLink("virtual", "echoes early", 1_000_000)
    require_order(CONTRACTS["window"].layout, {1: link})
    with pytest.raises(InputError, match=r"bus1 may report SYNC .* expected a SocketCAN driver"):
        require_order(two_states().layout, {1: link})
