"""The gateway's state of stepped blocks in the company of boards: what it calls valid, and what it asks for."""

import numpy as np
import pytest

from bus.link import State
from canskin.errors import InputError
from canskin.messages import BlockState
from dbc import indices as od
from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID, NmtCommand, NmtState
from dbc.contract import Contract
from dbc.dictionary import HEARTBEAT_MS, SILENT_AFTER_S
from dbc.frame import frames
from dbc.steps import KEEP_MIN, LATE_SLOTS
from gateway.block_states import FRESH_NS
from gateway.stepped_gathering import publishing_rates
from gateway.stepped_state import slots_of
from tests.bus.harness import frame
from tests.gateway.boards import STEP_S, BoardWorld, at_rest, known_of, lose, small_stepped, states, sums_of

DEAD, STALE, QUIET, FRESH = BlockState
#: Time in which a node that is started or asked tells all its sums, with a SYNC that it may wait for.
TOLD_S = 0.2


def test_measurement_holds_the_sums_of_the_boards_in_the_order_of_phi(boards: BoardWorld, stepped: Contract) -> None:
    assert boards.holds_what_boards_hold()
    newest = boards.measured[-1]
    taxels_n = stepped.phi.adjoint(np.frombuffer(newest.sums, "<i4").astype(np.float64))
    assert taxels_n[stepped.phi.taxels_of_blocks[1]].any()
    assert not taxels_n[stepped.phi.taxels_of_blocks[[0, 2, 3]]].any()
    assert len(newest.known) == 128
    assert np.frombuffer(newest.known, np.uint8).all()
    assert newest.fingerprint == stepped.phi.fingerprint
    assert newest.noise_n == pytest.approx(2.5e-4)
    assert boards.gateway.sync.counter - 1 <= newest.sync_counter <= boards.gateway.sync.counter
    assert newest.sampled_mono_ns <= round(boards.now_s * 1e9)


def test_something_is_published_ten_times_a_second_before_any_node_is_there(stepped: Contract) -> None:
    world = BoardWorld(stepped)
    for board in world.boards:
        board.answers = board.beats = False
    came = world.run(1.0)
    assert len(came) in {9, 10}
    assert [each.cycle for each in came] == list(range(1, len(came) + 1))
    assert all(states(each) == [DEAD] * 4 and not any(each.valid) and not any(each.known) for each in came)
    assert came[-1].noise_n == 0


def test_measurements_come_at_the_rates_that_were_asked_for(stepped: Contract) -> None:
    world = BoardWorld(stepped, rates_hz=publishing_rates(50.0, 2.0))
    world.until_whole(1.0)
    at_rest(world)
    assert len(world.run(5.0)) in {9, 10, 11}
    count = 0
    for seed in range(100):
        world.touch(0, seed)
        count += len(world.run(0.01))
    assert 40 <= count <= 50
    held = sums_of(world.run(0.3)[-1], 0)
    assert np.array_equal(held, world.known_counts(0))


@pytest.mark.parametrize(
    ("asked", "rates"),
    [
        ((None, None), (250.0, 10.0)),
        ((5.0, None), (5.0, 5.0)),
        ((1.0, 1.0), (1.0, 1.0)),
        ((1000.0, 1000.0), (1000.0, 1000.0)),
        ((0.999, None), None),
        ((1000.1, None), None),
        ((None, 0.999), None),
        ((20.0, 20.1), None),
    ],
)
def test_rates_are_one_to_a_thousand_hertz(
    asked: tuple[float | None, float | None], rates: tuple[float, float] | None
) -> None:
    if rates is None:
        with pytest.raises(InputError):
            publishing_rates(*asked)
    else:
        assert publishing_rates(*asked) == rates


@pytest.mark.parametrize("busy", [40, 10, 1])
def test_measurements_come_at_their_rate_soon_after_the_frames_of_a_slot(boards: BoardWorld, busy: int) -> None:
    """Frames come every 0.1 ms, in each slot of 4 ms for the first `busy` times."""
    gateway, first_s = boards.gateway, boards.now_s
    word, times_s, ages_s = frame(boards.contract.nodes[0].tpdos[0].cob_id, b"\1" + bytes(7)), [], []
    for step in range(25, 10_025):
        now_s = first_s + 1e-4 * step
        if step % 40 < busy:
            word["time_ns"], word["data"][0, 0] = round(now_s * 1e9), step % 240 + 1
            gateway.take(0, word, now_s, stamp_error_ns=0)
        if came := gateway.measurements(now_s):
            times_s.append(now_s)
            ages_s.append(now_s - 1e-9 * came[0].sampled_mono_ns)
        assert gateway.may_sleep_until_s <= (times_s or [now_s])[-1] + 4.1e-3 + 1e-9
    assert 240 <= len(times_s) <= 253
    assert np.quantile(ages_s[100:], 0.9) < 0.9e-3
    assert busy == 40 or np.quantile(ages_s[100:], 0.1) > 0.2e-3
    assert gateway.due_s <= now_s + 0.1


@pytest.mark.parametrize(
    ("after_s", "stamp_error_ns", "error_ns"),
    [
        # A sample of 1 ms, and what has passed since the node's place in its slot: half a slot after the first node's.
        (0.0025 + 0.0002, 0, 1_200_000),
        (0.0025 + 0.0042, 40_000, 5_240_000),
        (0.0025 + 0.0002, None, -1),
    ],
)
def test_the_sample_of_the_newest_frame_is_not_older_than_its_slot(
    boards: BoardWorld, after_s: float, stamp_error_ns: int | None, error_ns: int
) -> None:
    assert BoardWorld(boards.contract).run(0.3)[0].sampled_error_ns == -1  # no frame has come
    board, slot_s = boards.boards[1], boards.contract.layout.steps.slot_s
    boards.touch(1, 3)
    slot = 1 + int((boards.now_s - board.sync_s) / slot_s + 1e-6)
    (word,) = board.send(board.sync_s + slot * slot_s)
    ended_ns = round((board.sync_s + slot * slot_s + after_s) * 1e9)
    word["time_ns"] = ended_ns
    boards.gateway.take(0, word, ended_ns * 1e-9, stamp_error_ns=stamp_error_ns)
    made = boards.gateway.measurements(boards.now_s + 1.0)
    assert (made[0].sampled_mono_ns, made[0].sampled_error_ns) == (ended_ns, pytest.approx(error_ns, abs=2))


def test_block_is_fresh_for_a_tenth_of_a_second_and_quiet_from_then_on(boards: BoardWorld) -> None:
    boards.run(0.7)
    assert boards.measured[-1].states[0] == QUIET
    boards.touch(0, seed=5)
    boards.boards[0].speaks = True
    boards.step()
    seen_ns = round(boards.now_s * 1e9)
    assert boards.measured[-1].states[0] == FRESH
    boards.boards[0].speaks = False
    came = boards.run(0.25)
    assert came[-1].states[0] == QUIET
    assert np.frombuffer(came[-1].since_ns, "<i8")[0] == seen_ns + FRESH_NS
    assert came[-1].valid[0] == 1


def test_node_that_is_still_checks_now_and_then_and_stays_valid(boards: BoardWorld) -> None:
    at_rest(boards)
    sent = boards.boards[0].sent
    came = boards.run(10.0)
    assert 0 < boards.boards[0].sent - sent <= 10.0 / (boards.contract.keep_max * 0.005) + 1
    assert {each.states[0] for each in came} == {QUIET, FRESH}
    assert all(all(each.valid) for each in came)
    assert not any(board.asked for board in boards.boards)
    assert not boards.lines


def test_frames_and_counts_balance(boards: BoardWorld) -> None:
    for seed in range(20):
        boards.touch(seed % 4, seed, 0.001 * seed)
        boards.run(0.05)
    counts = boards.status().frames
    assert counts.received == counts.accepted == sum(board.sent for board in boards.boards)
    status = boards.status()
    assert status.cycles == len(boards.measured)
    assert status.cycles_complete == sum(all(each.valid) for each in boards.measured)
    assert (status.buses[0].missing, status.buses[0].late) == ([0, 0], [0, 0])
    assert counts.missing == counts.late == counts.malformed == 0


def test_lost_frames_make_blocks_stale_until_all_groups_have_come_again(boards: BoardWorld) -> None:
    boards.run(0.3)
    lose(boards, 0, 1)
    boards.touch(0, 18)
    boards.touch(1, 18)
    came = boards.run(2 * STEP_S)[-1]
    assert states(came)[:2] == [STALE, STALE]
    assert list(came.valid) == [0, 0, 1, 1]
    assert known_of(came, 0).all()
    assert boards.until_whole(1.0) <= 0.1
    assert [[value for _, value in board.asked] for board in boards.boards] == [[1], [1], [], []]
    assert boards.status().frames.after_gap == 2
    assert boards.holds_what_boards_hold()


def test_a_loss_at_the_end_of_a_movement_is_seen_at_the_next_check(boards: BoardWorld) -> None:
    at_rest(boards)
    boards.boards[0].sums_n[5] = 30 * boards.contract.unit_n  # one set tells all
    boards.wires[0].loses = lambda _end, each: each["can_id"] == boards.boards[0].contract.tpdos[0].cob_id
    boards.step()
    boards.wires[0].loses = None
    came = boards.run((KEEP_MIN + 1) * STEP_S)
    assert states(came[-1])[0] == STALE
    assert boards.until_whole(1.0) <= 0.1
    assert boards.holds_what_boards_hold()


@pytest.mark.parametrize("why", [State.BUS_OFF, State.LOST])
def test_controller_that_is_off_the_bus_makes_it_stale(boards: BoardWorld, why: State) -> None:
    boards.run(0.3)
    boards.link[1], boards.wires[1].gateway.is_held = why, True
    boards.touch(3, seed=7)
    came = boards.run(0.3)
    assert states(came[-1])[2:] == [STALE, STALE]
    assert came[-1].valid[:2] == b"\1\1"
    assert not any(boards.boards[3].asked)
    boards.wires[1].gateway.arriving.clear()
    boards.link[1], boards.wires[1].gateway.is_held = State.ACTIVE, False
    boards.hear(1, frames(0))
    assert boards.until_whole(1.0) <= 0.2
    assert boards.holds_what_boards_hold()


def test_a_bus_without_sync_is_stale_when_its_boards_have_no_slots_any_more(boards: BoardWorld) -> None:
    at_rest(boards)
    period_s = boards.contract.layout.sync.period_s
    boards.wires[0].loses = lambda _end, each: each["can_id"] == SYNC_COB_ID
    came = boards.run(2 * period_s)
    assert all(all(each.valid) for each in came)
    boards.touch(0, seed=7)
    came = boards.run(5 * period_s)
    assert states(came[-1])[:2] == [STALE, STALE]
    assert {each.valid for each in came[len(came) // 5 :]} == {b"\0\0\1\1"}
    boards.wires[0].loses = None
    assert boards.until_whole(1.0) <= period_s + STEP_S
    assert not any(board.asked for board in boards.boards)
    assert boards.holds_what_boards_hold()


def test_a_link_that_lost_frames_makes_its_bus_stale_until_the_next_words(boards: BoardWorld) -> None:
    """The words that were lost may have been the last for long."""
    at_rest(boards)
    lose(boards, 0)
    assert all(boards.measured[-1].valid)
    boards.dropped[0] += 1
    boards.hear(0, frames(0))
    came = boards.run(STEP_S)
    assert states(came[-1])[:2] == [STALE, STALE]
    assert came[-1].valid[2:] == b"\1\1"
    assert boards.until_whole(1.0) <= 0.2
    assert boards.holds_what_boards_hold()


def test_a_node_with_other_sums_is_told_once_and_asked(boards: BoardWorld) -> None:
    boards.run(0.3)
    boards.boards[1].sending.known[0, 2] += 1
    boards.boards[1].sums_n = boards.boards[1].sums_n.copy()
    boards.boards[1].sums_n[2] += boards.contract.unit_n
    boards.run(2.0)
    assert boards.complaints == ["node 2 on bus0 has other sums than the gateway: all are asked for"]
    assert [len(board.asked) for board in boards.boards] == [0, 1, 0, 0]
    assert boards.status().frames.different == 1
    assert boards.holds_what_boards_hold()


@pytest.mark.parametrize("wait", [2 * KEEP_MIN, 8 * KEEP_MIN])
def test_a_node_without_words_is_stale_after_its_own_wait_and_forgotten_after_the_longest(
    boards: BoardWorld, wait: int
) -> None:
    """Measurements come ten times a second at least."""
    boards.run(0.01)
    while boards.boards[1].sending.keep[0] != wait:
        boards.step()
    assert boards.measured[-1].valid[1]
    boards.boards[1].speaks = False
    silent_s, longest_s = boards.now_s, slots_of(boards.contract).silence * STEP_S
    came = boards.run(longest_s + 0.2)
    for state, after_s in ((STALE, (wait + LATE_SLOTS) * STEP_S), (DEAD, longest_s)):
        found = next(each for each in came if states(each)[1] == state)
        found_s = np.frombuffer(found.since_ns, "<i8")[1] / 1e9
        assert after_s - STEP_S <= found_s - silent_s <= after_s + 0.1 + 2 * LATE_SLOTS * STEP_S
    assert not known_of(came[-1], 1).any()
    assert boards.boards[1].asked
    assert all(each.valid[0] and each.valid[2] and each.valid[3] for each in came)
    boards.boards[1].speaks = True
    boards.until_whole(1.0)


@pytest.mark.parametrize("is_own", [False, True])
def test_another_sync_producer_makes_its_bus_stale(boards: BoardWorld, *, is_own: bool) -> None:
    """Also by a SYNC with the gateway's newest counter, which moves the slots by one."""
    boards.run(0.3)
    boards.until_sync()
    boards.wires[0].put(SYNC_COB_ID, bytes((boards.gateway.sync.counter if is_own else 0x55,)))
    came = boards.run(2 * STEP_S)
    assert states(came[-1])[:2] == [STALE, STALE]
    assert came[-1].valid[2:] == b"\1\1"
    assert boards.until_whole(1.0) <= 0.3
    assert boards.holds_what_boards_hold()


def test_reset_node_is_forgotten_at_once_and_comes_back_by_itself(boards: BoardWorld) -> None:
    boards.run(0.7)
    boards.nmt(0, NmtCommand.RESET_NODE, 2)
    came = boards.run(2 * STEP_S)
    assert states(came[-1])[1] == DEAD
    assert list(came[-1].valid) == [1, 0, 1, 1]
    assert not known_of(came[-1], 1).any()
    assert not sums_of(came[-1], 1).any()
    assert boards.until_whole(1.0) < 0.3
    assert not boards.boards[1].asked
    assert boards.holds_what_boards_hold()


def test_silent_node_is_dead(boards: BoardWorld) -> None:
    at_rest(boards)
    boards.boards[1].speaks = boards.boards[1].beats = False
    came = boards.run(HEARTBEAT_MS / 1000 + SILENT_AFTER_S + 0.2)
    assert states(came[-1])[1] == DEAD
    assert not known_of(came[-1], 1).any()
    assert list(came[-1].valid) == [1, 0, 1, 1]


def test_frames_of_a_node_that_is_not_proven_are_not_used() -> None:
    """Its unit differs: the same words would mean other forces."""
    world = BoardWorld(small_stepped(configure="refuse"))
    wrong = world.boards[2]
    wrong.objects[od.UNIT, 0] = b"\0\0\0\x40"
    wrong.objects[od.SIGNATURE, 0] = bytes(4)
    world.run(0.1)
    wrong.state = NmtState.OPERATIONAL
    wrong.again()
    world.touch(2)
    came = world.run(1.0)
    assert states(came[-1])[2] == DEAD
    assert not any(known_of(each, 2).any() for each in came)
    assert list(came[-1].valid) == [1, 1, 0, 1]
    counts = world.status().frames
    assert counts.unproven == wrong.sent > 0
    assert counts.received == sum(board.sent for board in world.boards)
    assert world.status().buses[1].refused == [1]


def test_frames_that_came_with_the_end_of_the_proof_are_not_used(stepped: Contract) -> None:
    """They may have been sent before the node was set right."""
    world = BoardWorld(stepped)
    board = world.boards[0]
    board.answers = False
    world.run(0.1)
    board.answers, world.wires[0].gateway.is_held = True, True
    world.run(0.3)  # the question is repeated
    board.state, board.sync_s, board.counter = NmtState.OPERATIONAL, world.now_s, 1
    board.again()
    world.run(2 * STEP_S)
    world.wires[0].gateway.is_held = False
    board.speaks = False
    world.run(2 * STEP_S)
    assert world.gateway.masters[0].nodes[1].in_use
    assert board.sent
    assert states(world.measured[-1])[0] == DEAD
    assert not known_of(world.measured[-1], 0).any()
    board.speaks = True
    world.until_whole(2 * TOLD_S)


def test_node_whose_test_pattern_somebody_sets_is_forgotten(boards: BoardWorld) -> None:
    at_rest(boards)
    request = b"\x2f" + od.TEST_PATTERN.to_bytes(2, "little") + b"\0\1\0\0\0"
    boards.wires[0].put(0x600 + 2, request)
    boards.touch(1, seed=9)
    came = boards.run(2 * STEP_S)
    assert states(came[-1])[1] == DEAD
    boards.boards[1].objects[od.TEST_PATTERN, 0] = b"\0"
    boards.until_whole(1.0)


def test_identifier_of_a_node_is_set_right_though_its_mapping_is_fixed(stepped: Contract) -> None:
    world = BoardWorld(stepped)
    board = world.boards[0]
    board.objects[od.TPDO_COMMUNICATION, 1] = b"\x23\x01\0\x40"
    board.objects[od.SIGNATURE, 0] = bytes(4)
    world.until_whole(2.0)
    world.run(0.3)
    written = [line for line in world.lines if "set right" in line]
    assert len(written) == 1
    assert "1800h:1" in written[0]


def test_gateway_that_joins_a_running_skin_starts_all_nodes_again(boards: BoardWorld) -> None:
    boards.touch(2, seed=4)
    at_rest(boards)
    for board in boards.boards:
        board.asked.clear()
    boards.gateway = boards.new_gateway()
    assert boards.until_whole(1.0) <= 0.4
    assert all(board.state is NmtState.OPERATIONAL for board in boards.boards)
    assert boards.holds_what_boards_hold()
    # A board may leave slots out: the new gateway counts from 1, and numbers of words rise.
    assert all(len(board.asked) <= 1 for board in boards.boards)


def test_strange_frames_are_counted_and_complained_about(boards: BoardWorld) -> None:
    boards.run(0.3)
    before = boards.status().frames
    wire = boards.wires[0]
    wire.put(SYNC_COB_ID, b"\1")
    wire.put(boards.contract.nodes[0].tpdos[0].cob_id + 9, bytes(8))
    wire.put(HEARTBEAT_BASE + 99, b"\5")
    wire.put(boards.contract.nodes[0].tpdos[0].cob_id, b"\1" * 7)
    boards.step()
    boards.run(0.6)
    after = boards.status().frames
    assert after.malformed == before.malformed + 1
    assert after.foreign >= before.foreign + 3
    assert len(boards.complaints) == 1
    assert boards.complaints[0].startswith(
        "another SYNC producer on bus0: its blocks are not valid until all sums have come again; "
    )
    assert all(boards.measured[-1].valid)


def test_the_newest_frame_of_each_bus_is_told(boards: BoardWorld) -> None:
    first = boards.measured[0]
    assert np.frombuffer(first.bus_sampled_ns, "<i8").tolist() == [0, 0]
    at_rest(boards)
    before = np.frombuffer(boards.measured[-1].bus_sampled_ns, "<i8")
    boards.touch(1, seed=5)
    boards.run(0.02)
    ended_ns = np.frombuffer(boards.measured[-1].bus_sampled_ns, "<i8")
    assert ended_ns[0] > before[0]
    assert ended_ns[1] == before[1]
    assert boards.measured[-1].sampled_mono_ns == ended_ns.max()
