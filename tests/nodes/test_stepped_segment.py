"""A bus of stepped nodes without a bus: what they send, and when."""

from pathlib import Path

import numpy as np
import pytest

from dbc.contract import Contract, frame_flags
from dbc.frame import ECHO, ERROR
from dbc.patch_filter import LEAST_NOISE_N
from dbc.steps import CHECK, KEEP_MIN, SET
from nodes.steps.stepping import LOST_NS
from skin.layout import changed, load_layout
from skin.walsh import walsh_matrix
from tests.bus.harness import frame
from tests.nodes.helpers import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, START, STOP
from tests.nodes.stepped_bus import IDS, PERIOD_MS, SET_MS, SLOT_MS, Bus, back

both = pytest.mark.parametrize("contract", ["steps", "steps-fd"], indirect=True)


@pytest.fixture(scope="module")
def contract(request: pytest.FixtureRequest) -> Contract:
    return Contract.from_layout(load_layout(Path(getattr(request, "param", "steps"))))


def kinds(bus: Bus) -> dict[int, set[int]]:
    """Return the kinds of words that came of each node since the last call."""
    found = {}
    for node in bus.contract.on_bus(0)[: len(IDS)]:
        words = [kind for part in bus.parts_of(node.block) for kind in part.kinds]
        if words:
            found[node.node_id] = set(words)
        for part in bus.parts_of(node.block):
            part.kinds = []
    return found


def test_nodes_that_are_not_started_filter_and_send_nothing_and_so_do_nodes_without_a_sync(bus: Bus) -> None:
    bus.sync()
    assert len(bus.run(150)) == 0
    assert bus.boards.sums.any()  # pressed meanwhile
    fresh = Bus(bus.contract)
    fresh.start()
    assert len(fresh.run(150)) == 0
    fresh.give(frame(0x80, b"", time_ns=round(fresh.now_s * 1e9)))  # one without counter
    assert len(fresh.run(50)) == 0


@both
def test_a_node_that_is_started_sets_all_its_sums_and_then_checks_ever_more_rarely(bus: Bus) -> None:
    bus.source.force_n[:] = 0
    bus.begin()
    groups = bus.contract.forms_of(0)[0].groups
    first = bus.run(SET_MS)
    assert kinds(bus) == {node_id: {SET} for node_id in IDS}
    assert len(first) == groups * len(IDS)
    assert set(first["length"]) == {32 if len(bus.contract.forms_of(0)) > 1 else 8}
    assert set(first["flags"]) == {frame_flags(bus.contract.layout.bus[0])}
    assert set(first["expires_ns"]) == {0}
    later = bus.run(5 * KEEP_MIN * round(1e3 * bus.contract.layout.steps.slot_s))
    assert kinds(bus) == {node_id: {CHECK} for node_id in IDS}
    assert len(later) == 2 * len(IDS)  # after `KEEP_MIN` slots, and after twice the time
    assert all(part.is_whole and not part.different for node in bus.blocks for part in bus.parts_of(node))


def test_each_node_sends_at_its_place_in_the_slot(bus: Bus) -> None:
    """32 boards share a slot, and a process decides once a millisecond."""
    bus.begin()
    sync_ns = round(bus.now_s * 1e9)
    sent = bus.run(SET_MS)
    for node_id in IDS:
        at_ms = (sent["time_ns"][sent["port"] == node_id] - sync_ns) / 1e6
        late_ms = at_ms - (node_id - 1) * SLOT_MS / 32 - SLOT_MS * np.arange(len(at_ms))
        assert len(at_ms) >= SET_MS / SLOT_MS - 1
        assert late_ms.min() > -1e-6
        assert late_ms.max() < 1 + 1e-6


def test_nodes_that_send_at_sync_send_at_once(contract: Contract) -> None:
    layout = changed(contract.layout, sync={"rate_hz": 200.0}, steps={"slot_s": 0.005, "at_sync": True})
    bus = Bus(Contract.from_layout(layout))
    bus.start()
    for counter in range(1, 12):
        bus.sync(counter)
        assert bus.run(1)["port"].tolist() == list(IDS)
        assert bus.run(3)["port"].tolist() == []
    assert all(part.is_whole for block in bus.blocks for part in bus.parts_of(block))


@both
def test_what_a_receiver_shows_is_what_the_touch_is(bus: Bus) -> None:
    bus.begin()
    bus.run(900)
    unit_n = bus.contract.unit_n
    for block in bus.blocks:
        shown = [value for part in bus.parts_of(block) for value in part.known.tolist()]
        assert shown == bus.known(block)
        force_n = bus.source.force_n.ravel()[bus.contract.phi.taxels_of_blocks[block]]
        true_n = walsh_matrix(32) @ np.clip(force_n, 0, 0.02)
        assert np.abs(np.array(shown) * unit_n - true_n)[1:].max() < 10 * unit_n
        assert abs(shown[0] * unit_n - true_n[0]) < 32 * LEAST_NOISE_N * 1.6  # an offset within the noise
        assert all(part.is_whole and not part.different and part.gaps == 1 for part in bus.parts_of(block))
    assert bus.segment.frames_sent == sum(len(bus.parts_of(block)[0].kinds) for block in bus.blocks)
    assert bus.segment.frames_dropped == 0


def test_the_first_sync_tells_when_the_touch_began(bus: Bus) -> None:
    begin_ns = round(bus.now_s * 1e9) - 2 * PERIOD_MS * 1_000_000
    for counter in (3, 1):
        bus.sync(counter)
    bus.run(12)
    truth = bus.boards.take_truth()
    assert truth is not None
    assert truth.step >= 20
    assert truth.sampled_mono_ns == begin_ns + truth.step * 10_000_000


def test_a_late_sync_lets_no_slot_come_twice(contract: Contract) -> None:
    bus = Bus(Contract.from_layout(changed(contract.layout, steps={"quiet": 0.0})))
    bus.begin()
    sent = [bus.run(99)]
    for late_ms in (0, 1, 3, 7):
        for _ in range(1 + late_ms):
            bus._sync_ms = 0
            sent.append(bus.run(1))
        bus.sync()
        sent.append(bus.run(98))
    frames = np.concatenate(sent)
    for node_id in IDS:
        slots = frames["data"][frames["port"] == node_id, 0].astype(int)
        assert set((np.diff(slots) % 240).tolist()) == {1}
    parts = [part for block in bus.blocks for part in bus.parts_of(block)]
    assert [part.gaps for part in parts] == [1] * len(parts)
    assert not any(part.different for part in parts)


def test_a_node_that_misses_a_sync_counts_on_and_is_silent_after_the_next(bus: Bus) -> None:
    bus.source.force_n[:] = 0.01
    assert bus.write(0x2031, 1, bytes(4), 2) == 0  # in every slot
    bus.begin()
    bus._counter = 0  # none follows
    sent = bus.run(400)
    assert len(sent[sent["port"] == 2]) == 2 * PERIOD_MS / SLOT_MS
    assert all(part.is_whole for part in bus.parts_of(bus.blocks[1]))


def test_while_a_frame_is_in_the_controller_its_node_leaves_slots_out(bus: Bus) -> None:
    bus.begin()
    waiting = bus.tick()
    while not len(waiting):
        waiting = bus.tick()
    bus.link.waiting.clear()  # no echo
    node_id = int(waiting["port"][0])
    others = [bus.tick() for _ in range(30)]
    assert node_id not in np.concatenate(others)["port"]
    assert bus.boards.is_sending
    bus.received.take(np.concatenate([waiting, *others]))
    bus.give(back(waiting[:1], ECHO))
    bus.run(90)
    assert [part.gaps for part in bus.parts_of(bus.blocks[node_id - 1])] == [1]  # nothing was lost


@both
@pytest.mark.parametrize("flags", [ECHO | ERROR, 0])
def test_after_a_frame_that_was_not_sent_a_node_sets_all_its_sums(bus: Bus, flags: int) -> None:
    bus.begin()
    bus.run(300)
    bus.write(0x2031, 1, bytes(4))
    lost = bus.tick()
    while 1 not in lost["port"]:
        lost = bus.tick()
    bus.link.waiting.clear()
    if flags:
        bus.give(back(lost, flags))  # given up
    else:
        bus.now_s += 1.1e-9 * LOST_NS  # the echo is lost
        bus.sync()
    kinds(bus)
    bus.run(SET_MS)
    for part in bus.parts_of(bus.blocks[0]):
        assert part.kinds[: part.form.groups] == [SET] * part.form.groups
    assert all(part.gaps == 2 and part.is_whole for part in bus.parts_of(bus.blocks[0]))
    assert [value for part in bus.parts_of(bus.blocks[0]) for value in part.known] == bus.known(bus.blocks[0])


def test_frames_that_a_full_queue_refuses_are_dropped_and_their_nodes_set_all_sums(bus: Bus) -> None:
    bus.begin()
    bus.link.room = 0
    assert len(bus.run(4 * SLOT_MS - 1)) == 0
    dropped = bus.segment.frames_dropped
    assert dropped == 4 * len(IDS)
    assert not bus.boards.is_sending
    bus.link.room = 1 << 30
    bus.run(SET_MS)
    assert all(part.is_whole for block in bus.blocks for part in bus.parts_of(block))
    by_node = [int.from_bytes(bus.read(0x2020, 2, node_id), "little") for node_id in IDS]
    lost = [int.from_bytes(bus.read(0x2020, 3, node_id), "little") for node_id in IDS]
    assert (sum(by_node), sum(lost)) == (bus.segment.frames_sent, dropped)


def test_stopped_nodes_send_nothing_and_begin_anew_when_they_are_started(bus: Bus) -> None:
    bus.begin()
    bus.run(5)
    for command in (PRE_OPERATIONAL, STOP):
        bus.give(frame(0, bytes((command, 0))))
        assert len(bus.run(200)) == 0
        bus.start()
        kinds(bus)
        bus.run(SET_MS)
        assert kinds(bus) == {node_id: {SET} for node_id in IDS}


def test_a_reset_forgets_what_was_sent_and_not_the_noise(contract: Contract) -> None:
    bus = Bus(contract)
    bus.begin()
    bus.run(300)
    noise = bus.read_real(0x2035)
    for command in (RESET_COMMUNICATION, RESET_NODE):
        assert any(bus.known(bus.blocks[0]))
        bus.give(frame(0, bytes((command, 1))))
        assert not any(bus.known(bus.blocks[0]))
        assert any(bus.known(bus.blocks[1]))
        assert bus.read_real(0x2035) == pytest.approx(noise, rel=0.3)
        assert 1 not in bus.run(20)["port"]
        bus.give(frame(0, bytes((START, 1))))
        kinds(bus)
        bus.run(SET_MS)
        assert kinds(bus)[1] == {SET}
        assert all(part.is_whole for part in bus.parts_of(bus.blocks[0]))


def test_what_was_sent_before_a_reset_does_not_come_back_with_its_echo(bus: Bus) -> None:
    bus.begin()
    while not len(bus.tick()):
        pass
    late = bus.link.receive()
    bus.give(frame(0, bytes((RESET_COMMUNICATION, 1))))
    bus.give(late)
    bus.give(frame(0, bytes((START, 1))))
    bus.run(SET_MS + 5)
    assert all(part.is_whole for part in bus.parts_of(bus.blocks[0]))
