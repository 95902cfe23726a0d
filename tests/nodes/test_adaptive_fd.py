"""Adaptive nodes on CAN FD: a frame carries all groups, and the urgency of the most urgent."""

from pathlib import Path

import numpy as np
import pytest

from dbc.adaptive import LEVELS, SendingRule, companding
from dbc.contract import Contract, sum_frame_bits
from dbc.frame import ECHO, ERROR
from nodes.adaptive.sending import decide, make_payload, new_groups, note_sent
from skin.layout import load_layout
from tests.layouts import BLOCK_SUMS, GROUPS
from tests.nodes.adaptive_bus import IDS, Bus, back, due_frames, meanings

LAW, RULE, NOISE_N2 = companding(0.02, 0.5e-3, BLOCK_SUMS), SendingRule(), 1e-9


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout(Path("adaptive-fd")))


def test_a_frame_that_found_no_room_or_lost_the_bus_frees_all_groups(bus: Bus) -> None:
    bus.start()
    bus.link.room = 0
    bus.run(3)
    assert bus.segment.frames_dropped > 0
    assert not bus.boards.is_sending
    bus.link.room = 1 << 30
    sent = bus.run(1)
    assert sorted(meanings(sent)) == [(node, 0, 0, False) for node in IDS]
    held = bus.boards.groups.known_n.copy()
    bus.boards.groups.under_way[:] = 1 << 60
    bus.give(back(sent, ECHO | ERROR))
    assert not bus.boards.is_sending
    assert np.array_equal(bus.boards.groups.known_n, held)


def test_a_request_for_one_group_is_answered_by_a_frame_of_all(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    assert bus.write(0x2030, 0, b"\x04") == 0
    assert meanings(bus.run(2)) == [(1, 0, 0, False)]
    assert bus.read(0x2030) == b"\0"


def test_frames_of_both_lengths_cost_the_budget_their_bits(bus: Bus) -> None:
    line = bus.contract.layout.bus[0]
    coarse, fine = (sum_frame_bits(line, GROUPS, is_fine=is_fine) for is_fine in (False, True))
    assert fine > coarse
    assert (bus.boards.controllers.frame_bits == [coarse, fine]).all()


class Node:
    """The decisions of one node, whose frames go at once."""

    def __init__(self) -> None:
        self.groups, self.now, self.sums_n = new_groups(1, GROUPS, True), 0, np.zeros(BLOCK_SUMS, np.float32)

    def step(self, ticks: int = 1) -> list[tuple[int, int, int]]:
        """Return sample, level and bytes of each frame."""
        sent, payload = [], np.zeros(64, np.uint8)
        for _ in range(ticks):
            self.now += 1
            decide(0, self.now, self.sums_n, np.zeros(BLOCK_SUMS, np.float32), NOISE_N2, RULE, LAW, self.groups)
            for group, _ in due_frames(self.groups):
                level = int(self.groups.level[0, group])
                length = make_payload(0, group, self.sums_n, LAW, self.groups, payload)
                note_sent(0, 0, self.now, length == 64, RULE, LAW, self.groups, payload)
                sent.append((self.now, level, length))
        return sent


def test_news_of_a_group_carries_the_others_and_does_not_begin_their_refreshes_anew() -> None:
    node = Node()
    node.sums_n[:] = 0.0213
    ((_, _, first),) = node.step()
    assert first == 32
    node.step(600)
    after = node.groups.refresh_after[0].copy()
    node.sums_n[25] = 0.06
    sent = node.step(3)
    assert [length for _, _, length in sent] == [32]
    assert sent[0][1] < LEVELS - 1
    assert node.groups.refresh_after[0].tolist() == [*after[:3].tolist(), RULE.refresh]
    assert (node.groups.refresh_at[0] == sent[0][0] + node.groups.refresh_after[0]).all()


def test_details_come_in_one_frame_of_all_groups_and_then_silence() -> None:
    node = Node()
    node.sums_n[:] = np.random.default_rng(3).uniform(0.01, 0.05, BLOCK_SUMS)
    sent = node.step(60)
    assert [length for _, _, length in sent] == [32, 64]
    assert np.abs(node.groups.known_n[0] - node.sums_n).max() <= 0.51 * LAW.fine_n
    assert sent[1][0] - sent[0][0] == RULE.fine_wait
    times = [now for now, _, _ in node.step(4000)]
    assert max(np.diff(times)) <= RULE.refresh_max
    assert len(times) < 10


def test_sums_out_of_the_reach_of_their_codes_end_no_silence() -> None:
    node = Node()
    node.sums_n[:] = np.random.default_rng(4).uniform(0.28, 0.31, BLOCK_SUMS)
    assert len(node.step(200)) < 8


def test_a_block_at_zero_falls_silent() -> None:
    node = Node()
    node.sums_n[:] = 0.02
    node.step(50)
    node.sums_n[:] = 0
    assert node.step(6000)
    assert node.step(3000) == []
