"""A bus of adaptive nodes without a bus: what they send, and when."""

import struct
from pathlib import Path

import numpy as np
import pytest

from dbc.adaptive import LOST_NS, SAVED_FRAMES
from dbc.adaptive_filter import LEAST_NOISE_N
from dbc.contract import Contract, frame_flags, sum_frame_bits
from dbc.frame import ECHO, ERROR
from nodes.adaptive.news import PAUSE_NS
from skin.layout import load_layout
from skin.walsh import walsh_matrix
from tests.bus.harness import frame
from tests.layouts import GROUPS
from tests.nodes.adaptive_bus import IDS, Bus, back, meanings, sums_of
from tests.nodes.helpers import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, START, STOP

both = pytest.mark.parametrize("contract", ["adaptive", "adaptive-fd"], indirect=True)


@pytest.fixture(scope="module")
def contract(request: pytest.FixtureRequest) -> Contract:
    return Contract.from_layout(load_layout(Path(getattr(request, "param", "adaptive"))))


def test_nodes_filter_before_they_are_started_and_send_nothing(bus: Bus) -> None:
    bus.sync()
    assert len(bus.run(150)) == 0
    assert bus.read(0x2110, 1) != b"\0"  # pressed meanwhile


@both
def test_a_node_that_is_started_sends_all_groups_once_and_then_again_ever_more_rarely(bus: Bus) -> None:
    bus.start()
    first = bus.run(2)
    groups = range(1 if bus.is_fd else GROUPS)
    assert sorted(meanings(first)) == sorted((node, 0, group, False) for node in IDS for group in groups)
    assert set(first["length"]) == {32 if bus.is_fd else 8}
    assert set(first["flags"]) == {frame_flags(bus.contract.layout.bus[0])}
    later = [len(bus.run(ticks)) for ticks in (50, 20, 100, 40)]
    assert later == [0, len(first), 0, len(first)]


@both
def test_what_a_receiver_shows_is_what_the_touch_is(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    bus.sync()
    sent = bus.run(600)
    assert set(sent["length"]) == ({32, 64} if bus.is_fd else {8})
    assert not sent["data"][sent["length"] == 32, 32:].any()
    law = bus.contract.law
    for row, node in enumerate(bus.contract.on_bus(0)[: len(IDS)]):
        force_n = bus.source.force_n.ravel()[bus.contract.phi.taxels_of_blocks[node.block]]
        true_n = walsh_matrix(32) @ np.clip(force_n, 0, 0.02)
        assert np.abs(bus.received.value_n[row] - true_n)[1:].max() < 2 * law.fine_n
        assert abs(bus.received.value_n[row, 0] - true_n[0]) < 32 * LEAST_NOISE_N * 1.6  # an offset within the noise
        assert np.array_equal(bus.received.value_n[row], bus.boards.groups.known_n[row])
    assert not bus.received.counts[1:].any()
    assert bus.segment.frames_sent == bus.received.counts[0]
    assert bus.segment.frames_dropped == 0


@both
def test_a_node_keeps_its_budget(bus: Bus) -> None:
    coarse = sum_frame_bits(bus.contract.layout.bus[0], GROUPS, is_fine=False)
    assert bus.write(0x2034, 0, struct.pack("<I", 20 * coarse)) == 0
    bus.start()
    bus.sync()
    sent = [each for each in meanings(bus.run(1100)) if each[0] in {1, 2}]
    limited, free = ([each for each in sent if each[0] == node] for node in (1, 2))
    groups = 1 if bus.is_fd else GROUPS
    assert len(limited) < SAVED_FRAMES + 22 + 2 * groups * 5  # saved up, earned, refreshes
    assert len(limited) < len(free) + bus.is_fd
    assert {group for _, _, group, _ in limited} == set(range(groups))


def test_no_sums_in_the_millisecond_after_a_sync_and_none_waits_beyond_the_next(bus: Bus) -> None:
    bus.start()
    bus.sync()
    sync_ns = round(bus.now_s * 1e9)
    for tick in range(1, 100):
        sent = bus.run(1)
        assert (sent["time_ns"] >= sync_ns + PAUSE_NS).all()
        assert (sent["expires_ns"] <= sync_ns + 100_000_000).all()
        assert (sent["expires_ns"] - sent["time_ns"] <= 1_100_000).all(), tick


def test_a_frame_that_comes_back_unsent_is_made_anew_of_newer_samples(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    bus.sync()
    while True:
        bus.now_s += 1e-3
        bus.segment.tick(bus.now_s)
        first = sums_of(bus.link.take_sent())
        bus.link.waiting.clear()
        if len(first):
            break
    known = bus.boards.groups.known_n.copy()
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    held = {(node, group) for node, _, group, _ in meanings(first)}
    second = sums_of(bus.link.take_sent())
    assert not held & {(node, group) for node, _, group, _ in meanings(second)}  # it may still win the bus
    bus.link.waiting.clear()
    bus.give(back(first, ECHO | ERROR), back(second, ECHO | ERROR))
    assert np.array_equal(bus.boards.groups.known_n, known)
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    again = sums_of(bus.link.take_sent())
    assert held <= {(node, group) for node, _, group, _ in meanings(again)}
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (16, 0)


def test_a_frame_whose_echo_is_lost_is_given_up_in_the_end(bus: Bus) -> None:
    bus.start()
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    assert len(sums_of(bus.link.take_sent()))
    bus.link.waiting.clear()
    bus.now_s += 0.9e-9 * LOST_NS
    bus.segment.tick(bus.now_s)
    waiting = sums_of(bus.link.take_sent())
    bus.link.waiting.clear()
    bus.now_s += 0.2e-9 * LOST_NS
    bus.segment.tick(bus.now_s)
    assert len(sums_of(bus.link.take_sent())) > len(waiting)


def test_frames_that_a_full_queue_refuses_are_dropped_and_made_anew(bus: Bus) -> None:
    bus.start()
    bus.link.room = 3
    assert len(bus.run(1)) == 3
    dropped = bus.segment.frames_dropped
    assert dropped > 0
    bus.link.room = 1 << 30
    assert len(bus.run(3)) == 13
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (16, dropped)
    by_node = [int.from_bytes(bus.read(0x2020, 2, node_id), "little") for node_id in IDS]
    lost = [int.from_bytes(bus.read(0x2020, 3, node_id), "little") for node_id in IDS]
    assert (sum(by_node), sum(lost)) == (16, dropped)


def test_stopped_nodes_send_nothing_and_begin_anew_when_they_are_started(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    for command in (PRE_OPERATIONAL, STOP):
        bus.give(frame(0, bytes((command, 0))))
        assert len(bus.run(200)) == 0
        bus.start()
        assert len(bus.run(5)) == 16


def test_a_reset_forgets_what_was_sent_and_not_the_noise(contract: Contract) -> None:
    bus = Bus(contract)
    bus.start()
    bus.run(5)
    bus.sync()
    bus.run(300)
    assert bus.boards.groups.known_n[0].any()
    noise = bus.read_real(0x2035)
    for command in (RESET_COMMUNICATION, RESET_NODE):
        bus.give(frame(0, bytes((command, 1))))
        assert not bus.boards.groups.known_n[0].any()
        assert bus.boards.groups.known_n[1].any()
        assert bus.read_real(0x2035) == pytest.approx(noise, rel=0.3)
        assert not [each for each in meanings(bus.run(20)) if each[0] == 1]
        bus.give(frame(0, bytes((START, 1))))
        assert {(group, fine) for node, _, group, fine in meanings(bus.run(3)) if node == 1} == {
            (group, False) for group in range(GROUPS)
        }


def test_what_was_sent_before_a_reset_does_not_come_back_with_its_echo(bus: Bus) -> None:
    bus.start()
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    late = bus.link.receive()
    bus.give(frame(0, bytes((RESET_COMMUNICATION, 1))))
    bus.give(late)
    assert len(bus.run(100)) > 0  # the others' refreshes
    assert bus.segment.frames_sent >= 16
