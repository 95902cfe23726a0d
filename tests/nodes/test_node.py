"""One node: NMT states, resets, error reaction, emergencies, and the objects of each of its blocks."""

import struct
from pathlib import Path

import pytest

from dbc import indices as od
from dbc.board_sums import PATTERN_FULL, PATTERN_ZERO
from dbc.canopen import NmtState
from dbc.configuration import configuration, expected_signature
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.segment import Segment
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.nodes.helpers import (
    PRE_OPERATIONAL,
    RESET_NODE,
    START,
    STOP,
    ArrayLink,
    Still,
    give,
    new_segment,
    read,
    sync,
    write,
)

WATCHED = 0x7F
EMCY_1 = 0x81


def nmt(command: int) -> Frames:
    return frame(0, bytes((command, 1)))


def sent_after(segment: Segment, link: ArrayLink, now_s: float, can_id: int) -> list[bytes]:
    """Let time pass; return the payloads that are sent with an identifier."""
    link.take_sent()
    segment.tick(now_s)
    return [one["data"][:8].tobytes() for one in link.take_sent() if one["can_id"] == can_id]


def emergencies(segment: Segment, link: ArrayLink, now_s: float) -> list[int]:
    """Let time pass; return the error codes that node 1 sends."""
    return [struct.unpack("<H", data[:2])[0] for data in sent_after(segment, link, now_s, EMCY_1)]


def state(segment: Segment, link: ArrayLink, now_s: float) -> int:
    """Let time pass; return the state that the heartbeat of node 1 tells."""
    return sent_after(segment, link, now_s, 0x701)[0][0]


def lose_heartbeat(segment: Segment, link: ArrayLink, now_s: float = 1e3) -> None:
    """Let node 1 watch another node, whose heartbeat stops."""
    assert write(segment, link, 0x1016, 1, WATCHED << 16 | 100, 4) == 0
    give(segment, link, frame(0x700 + WATCHED, b"\5"), now_s=now_s)
    segment.tick(now_s + 0.2)


@pytest.mark.parametrize(
    ("command", "expected"), [(START, 5), (STOP, 4), (PRE_OPERATIONAL, 127)], ids=["start", "stop", "pre-operational"]
)
def test_heartbeat_tells_the_state_that_was_commanded(
    segment: Segment, link: ArrayLink, command: int, expected: int
) -> None:
    give(segment, link, nmt(START), nmt(command))
    assert state(segment, link, 2.0) == expected


def beats(segment: Segment, link: ArrayLink, now_s: float) -> list[int]:
    link.take_sent()
    segment.tick(now_s)
    return [int(can_id) - 0x700 for can_id in link.take_sent()["can_id"]]


def test_heartbeats_are_sent_when_they_are_due_within_five_milliseconds(segment: Segment, link: ArrayLink) -> None:
    """The first after boot-up: node-ID / 128 s."""
    assert beats(segment, link, 0.003) == []
    assert beats(segment, link, 0.0079) == []  # due, but 5 ms have not passed
    assert beats(segment, link, 0.003 + 0.005) == [1]
    assert beats(segment, link, 0.0145) == []
    assert beats(segment, link, 3 / 128) == [2, 3]
    assert beats(segment, link, 0.0305) == []
    assert beats(segment, link, 0.0365) == [4]
    assert beats(segment, link, 1.0065) == []
    assert beats(segment, link, 1.2) == [1, 2, 3, 4]
    segment.boot(1.2)
    assert beats(segment, link, 1.3) == [1, 2, 3, 4]


def test_a_new_period_counts_from_its_write_and_other_writes_put_no_beat_off(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1017, 0, 500, 2) == 0
    give(segment, link, frame(0x601, struct.pack("<BHBI", 0x2F, 0x1029, 1, 0)), now_s=0.3)
    assert 1 in beats(segment, link, 0.5)
    assert write(segment, link, 0x1017, 0, 0, 2) == 0
    assert 1 not in beats(segment, link, 1e3)


@pytest.mark.parametrize(
    ("behaviour", "expected"), [(0, NmtState.PRE_OPERATIONAL), (1, NmtState.OPERATIONAL), (2, NmtState.STOPPED)]
)
def test_error_behaviour_of_an_operational_node(
    segment: Segment, link: ArrayLink, behaviour: int, expected: NmtState
) -> None:
    assert write(segment, link, 0x1029, 1, behaviour, 1) == 0
    give(segment, link, nmt(START))
    lose_heartbeat(segment, link)
    assert state(segment, link, 2e3) == expected


@pytest.mark.parametrize("command", [STOP, PRE_OPERATIONAL])
def test_lost_heartbeat_changes_no_other_state(segment: Segment, link: ArrayLink, command: int) -> None:
    write(segment, link, 0x1029, 1, 0 if command == STOP else 2, 1)
    assert write(segment, link, 0x1016, 1, WATCHED << 16 | 100, 4) == 0
    give(segment, link, nmt(command))
    before = state(segment, link, 900.0)
    give(segment, link, frame(0x700 + WATCHED, b"\5"), now_s=1e3)
    segment.tick(1e3 + 0.2)
    assert state(segment, link, 2e3) == before


def test_emergency_comes_when_a_heartbeat_is_lost_and_goes_when_it_is_back(segment: Segment, link: ArrayLink) -> None:
    lose_heartbeat(segment, link)
    assert read(segment, link, 1, 0x1001) == 0x11
    give(segment, link, frame(0x700 + WATCHED, b"\5"), now_s=2e3)
    assert read(segment, link, 1, 0x1001) == 0
    assert emergencies(segment, link, 2e3 + 0.05) == [0]


def test_emergency_goes_when_the_lost_node_is_watched_no_longer(segment: Segment, link: ArrayLink) -> None:
    lose_heartbeat(segment, link)
    assert read(segment, link, 1, 0x1001) == 0x11
    assert write(segment, link, 0x1016, 1, 0, 4) == 0
    assert emergencies(segment, link, 2e3) == [0]
    assert read(segment, link, 1, 0x1001) == 0
    lose_heartbeat(segment, link, 3e3)
    assert EMCY_1 in link.take_sent()["can_id"]


def test_stopped_node_keeps_its_emergency_until_it_may_speak(segment: Segment, link: ArrayLink) -> None:
    give(segment, link, nmt(START), frame(0x80, b"\1\2"), nmt(STOP))
    assert emergencies(segment, link, 1e3) == []
    give(segment, link, nmt(PRE_OPERATIONAL))
    assert emergencies(segment, link, 2e3) == [0x8240]


def test_emergency_does_not_wait_for_the_next_heartbeat(segment: Segment, link: ArrayLink) -> None:
    segment.tick(1e3)  # all beat: the next is due in 1 s
    give(segment, link, nmt(START), frame(0x80, b"\1\2"), now_s=1e3)
    assert emergencies(segment, link, 1e3 + 0.1) == [0x8240]


def test_emergency_that_is_switched_off_is_not_sent(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1014, 0, 0x8000_0081, 4) == 0
    give(segment, link, nmt(START), frame(0x80, b"\1\2"))
    assert emergencies(segment, link, 1e3) == []
    assert read(segment, link, 1, 0x1003, 0) == 1


def test_inhibit_time_between_emergencies_is_in_tenths_of_a_millisecond(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1015, 0, 1000, 2) == 0
    give(segment, link, nmt(START), frame(0x80, b"\1\2"), sync(1), now_s=1e3)  # comes and goes
    assert sent_after(segment, link, 2e3, EMCY_1) == [bytes.fromhex("4082110200000000")]
    assert emergencies(segment, link, 2e3 + 0.09) == []
    assert sent_after(segment, link, 2e3 + 0.11, EMCY_1) == [bytes.fromhex("0000004082000000")]


def test_error_field_holds_the_newest_eight_and_can_be_cleared(segment: Segment, link: ArrayLink) -> None:
    give(segment, link, nmt(START))
    for length in range(2, 8):
        give(segment, link, frame(0x80, bytes(length)), sync(1))
        lose_heartbeat(segment, link, 1e3 * length)
        give(segment, link, frame(0x700 + WATCHED, b"\5"), nmt(START), now_s=1e3 * length + 0.5)
    errors = [read(segment, link, 1, 0x1003, place) for place in range(9)]
    assert errors == [8, *(each for length in (7, 6, 5, 4) for each in (WATCHED << 16 | 0x8130, length << 16 | 0x8240))]
    assert write(segment, link, 0x1003, 0, 0, 1) == 0
    assert read(segment, link, 1, 0x1003, 0) == 0


def test_reset_ends_errors_counters_and_what_was_written(segment: Segment, link: ArrayLink) -> None:
    write(segment, link, 0x1800, 1, 0xC000_0181, 4)
    give(segment, link, nmt(START), sync(1), frame(0x80, b"\1\2"))
    assert (read(segment, link, 1, 0x1001), read(segment, link, 1, od.HEALTH, 1)) == (0x11, 2)
    give(segment, link, nmt(RESET_NODE))
    assert (read(segment, link, 1, 0x1001), read(segment, link, 1, 0x1003, 0)) == (0, 0)
    assert [read(segment, link, 1, od.HEALTH, place) for place in (1, 2, 3)] == [0, 0, 0]
    assert emergencies(segment, link, 1e3) == []
    give(segment, link, nmt(START), frame(0x80, b"\1\2"))
    assert emergencies(segment, link, 2e3) == [0x8240]  # news again
    give(segment, link, nmt(START))
    assert [can_id for can_id, _ in give(segment, link, sync(3))] == [0x181, 0x281]


def test_watching_begins_anew_after_a_reset(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1016, 1, WATCHED << 16 | 100, 4) == 0
    assert write(segment, link, 0x1010, 1, od.SIGNATURE_SAVE, 4) == 0
    give(segment, link, frame(0x700 + WATCHED, b"\5"), now_s=1e3)
    give(segment, link, nmt(RESET_NODE), now_s=1e3)
    segment.tick(1e3 + 0.2)
    assert read(segment, link, 1, 0x1001) == 0
    give(segment, link, frame(0x700 + WATCHED, b"\5"), now_s=2e3)
    segment.tick(2e3 + 0.2)
    assert read(segment, link, 1, 0x1001) == 0x11


def test_signature_is_that_of_what_the_node_does_now(segment: Segment, link: ArrayLink, contract: Contract) -> None:
    settings = configuration(contract, contract.on_bus(0)[0])
    right = expected_signature(settings)
    assert read(segment, link, 1, od.SIGNATURE) == right
    seen = {right}
    for index, subindex, value, size in (
        (0x1007, 0, 5000, 4),
        (0x1800, 1, 0xC000_0181, 4),
        (0x1A00, 0, 0, 1),
        (od.TEST_PATTERN, 0, 2, 1),
    ):
        assert write(segment, link, index, subindex, value, size) == 0
        assert read(segment, link, 1, od.SIGNATURE) not in seen
        seen.add(read(segment, link, 1, od.SIGNATURE))
    write(segment, link, 0x2011, 3, 100, 2)
    assert read(segment, link, 1, od.SIGNATURE) in seen  # an offset is no part of it
    give(segment, link, nmt(RESET_NODE))
    assert read(segment, link, 1, od.SIGNATURE) == right


class Blocks:
    """Node 1 of the skin of CAN FD, which has four blocks."""

    def __init__(self) -> None:
        self.contract = Contract.from_layout(load_layout(Path("fd")))
        taxels = self.contract.layout.taxels
        self.electronics = Electronics(taxels, noise_n=0.0)
        self.sampler = Sampler(self.contract.phi, Still(self.contract), self.electronics)
        self.link = ArrayLink()
        self.segment = new_segment(self.contract, self.link, {1}, sampler=self.sampler)

    def write(self, index: int, subindex: int, value: int, size: int) -> None:
        assert write(self.segment, self.link, index, subindex, value, size) == 0


def test_saturated_taxels_of_all_blocks_are_counted() -> None:
    node = Blocks()
    for block, pattern in enumerate((PATTERN_ZERO, PATTERN_FULL, PATTERN_ZERO, PATTERN_FULL)):
        node.write(od.of_block(od.TEST_PATTERN, block), 0, pattern, 1)
    give(node.segment, node.link, nmt(START), sync(1))
    assert read(node.segment, node.link, 1, od.HEALTH, 4) == 2 * node.contract.phi.block_size


def test_offset_goes_to_the_taxel_of_its_block_and_may_be_negative() -> None:
    node = Blocks()
    node.write(od.of_block(od.OFFSET, 2), 3, 0xFFFB, 2)
    taxel = node.contract.phi.order[2 * node.contract.phi.block_size + 2]
    assert node.electronics.offset[taxel] == -5.0
    assert (node.electronics.offset != 0).sum() == 1


def test_own_echo_of_a_heartbeat_is_heard_by_the_nodes_beside_it(segment: Segment, link: ArrayLink) -> None:
    write(segment, link, 0x1016, 1, 2 << 16 | 100, 4)
    give(segment, link, frame(0x702, b"\5", ECHO), now_s=1e3)
    assert emergencies(segment, link, 1e3 + 0.2) == [0x8130]
