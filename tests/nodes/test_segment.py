"""What nodes answer to frames: NMT, SYNC, SDO; and that nothing on the wire can end their loop."""

import struct

import numpy as np
import pytest

from dbc.contract import Contract
from dbc.dictionary import REACTION_NS, WINDOWS_MET
from dbc.frame import ECHO, ERROR, EXTENDED, FRAME, REMOTE, Frames
from nodes.segment import Segment
from tests.bus.harness import frame
from tests.layouts import in_turns
from tests.nodes.helpers import (
    MILLISECOND_NS,
    PRE_OPERATIONAL,
    RESET_NODE,
    START,
    STOP,
    ArrayLink,
    give,
    new_segment,
    read,
    sdo,
    sync,
    write,
)


def test_boot_up_of_every_node(segment: Segment, link: ArrayLink) -> None:
    sent = link.take_sent()
    assert sent["can_id"].tolist() == [0x701, 0x702, 0x703, 0x704]
    assert not sent["data"].any()


def test_pdos_in_operational_only(segment: Segment, link: ArrayLink) -> None:
    assert give(segment, link, sync(1)) == []
    assert give(segment, link, frame(0, bytes((START, 2))), sync(2)) != []
    assert {can_id for can_id, _ in give(segment, link, sync(3))} == {0x182, 0x282}
    assert give(segment, link, frame(0, bytes((STOP, 0))), sync(4)) == []
    assert give(segment, link, frame(0x603, struct.pack("<BHB4x", 0x40, 0x1018, 1))) == []  # nor an answer of SDO
    assert give(segment, link, frame(0, bytes((START, 0))), frame(0, bytes((PRE_OPERATIONAL, 0))), sync(5)) == []
    in_order = frame(0, bytes((START, 0))), sync(6), frame(0, bytes((PRE_OPERATIONAL, 0))), sync(7)
    assert {payload[0] for _, payload in give(segment, link, *in_order)} == {6}


@pytest.mark.parametrize("flag", [ERROR, EXTENDED, REMOTE, ECHO])
def test_reports_echoes_and_frames_of_other_formats_command_nothing(
    contract: Contract, link: ArrayLink, flag: int
) -> None:
    complaints: list[str] = []
    segment = new_segment(contract, link, {1, 2}, complain=complaints.append)
    give(segment, link, frame(0, bytes((START, 1))))
    assert give(segment, link, frame(0, bytes((START, 2)), flag), frame(0x80, b"", flag)) == []
    assert give(segment, link, frame(0x601, bytes.fromhex("4017100000000000"), flag), frame(0x702, b"\5", flag)) == []
    assert (complaints, segment.syncs_seen, segment.boards.nodes[1].state) == ([], 0, 127)
    give(segment, link, *(frame(0x700 + node_id, b"\5") for node_id in (2, 3, 0)))
    assert complaints == ["node-ID 2 is on bus0 twice"]


def test_frames_name_the_sync_that_they_answer(segment: Segment, link: ArrayLink) -> None:
    give(segment, link, frame(0, bytes((START, 1))))
    for counter in (1, 239, 240, 1):
        assert [payload[0] for _, payload in give(segment, link, sync(counter))] == [counter, counter]
        assert read(segment, link, 1, 0x2022) == counter
    assert [payload[0] for _, payload in give(segment, link, frame(0x80))] == [0, 0]  # a SYNC without counter
    assert read(segment, link, 1, 0x2022) == 0


@pytest.fixture
def segment_in_turns(contract: Contract, link: ArrayLink) -> Segment:
    return new_segment(Contract.from_layout(in_turns(contract.layout)), link, {1, 2, 3, 4})


def test_half_of_the_sums_go_in_odd_and_half_in_even_cycles(segment_in_turns: Segment, link: ArrayLink) -> None:
    segment = segment_in_turns
    give(segment, link, frame(0, bytes((START, 0))))
    odd, even = give(segment, link, sync(1)), give(segment, link, sync(2))
    assert [can_id for can_id, _ in odd] == [0x181, 0x182, 0x183, 0x184]
    assert [can_id for can_id, _ in even] == [0x281, 0x282, 0x283, 0x284]
    for first, ((_, payload), counter) in ((1, (odd[0], 1)), (5, (even[0], 2))):
        assert payload[0] == counter
        packed = int.from_bytes(payload[1:], "little")
        raw = [packed >> 14 * place & 0x3FFF for place in range(4)]
        assert [read(segment, link, 1, 0x2100, first + place) & 0x3FFF for place in range(4)] == raw


def test_frames_start_after_the_reaction_time_and_end_inside_the_window_of_their_node(
    segment: Segment, link: ArrayLink
) -> None:
    """135 µs are the longest frame; a window of 0 is no limit."""
    assert read(segment, link, 1, 0x1007) == 9900
    assert write(segment, link, 0x1007, 0, 5000, 4) == 0
    give(segment, link, frame(0, bytes((START, 0))))
    sent = give_sent(segment, link, 7)
    assert set(sent["time_ns"].tolist()) == {70 * MILLISECOND_NS + REACTION_NS}
    window_us = (sent["expires_ns"] - 70 * MILLISECOND_NS) / 1000
    by_node = dict(zip(sent["port"].tolist(), window_us.tolist(), strict=True))
    assert by_node == {1: 5000 - 135, **dict.fromkeys((2, 3, 4), 9900 - 135)}
    assert write(segment, link, 0x1007, 0, 0, 4) == 0
    sent = give_sent(segment, link, 8)
    assert (sent["expires_ns"][sent["port"] == 1] > 10**9 * MILLISECOND_NS).all()


def give_sent(segment: Segment, link: ArrayLink, counter: int) -> Frames:
    """Return the frames that answer a SYNC."""
    link.take_sent()
    segment.take(sync(counter), 0.0)
    return link.take_sent()


def test_pdos_without_room_are_counted_as_dropped_and_not_as_sent(segment: Segment, link: ArrayLink) -> None:
    give(segment, link, frame(0, bytes((START, 1))), frame(0, bytes((START, 2))))
    link.room = 3
    give(segment, link, sync(1))
    assert (segment.frames_sent, segment.frames_dropped) == (3, 1)
    link.room = 1 << 30
    counts = [[read(segment, link, node_id, 0x2020, place) for place in (2, 3)] for node_id in (1, 2)]
    assert sorted(counts) == [[1, 1], [2, 0]]
    segment.tick(1e6)
    assert not {0x81, 0x82} & {*link.take_sent()["can_id"]}
    assert [read(segment, link, node_id, 0x2020, 1) for node_id in (1, 2, 3)] == [1, 1, 0]


def test_dropped_outside_the_window_is_counted_and_reported(segment: Segment, link: ArrayLink) -> None:
    give(segment, link, frame(0, bytes((START, 1))))
    link.waiting.append(sync(1))
    segment.take(link.receive(), 0.0)
    unsent = link.take_sent()
    unsent["flags"] |= ECHO | ERROR
    link.waiting[:] = [unsent]
    segment.take(link.receive(), 0.0)
    segment.tick(1e6)
    emcy = [one["data"][:8].tobytes() for one in link.take_sent() if one["can_id"] == 0x81]
    assert [struct.unpack("<HB", one[:3]) for one in emcy] == [(0xFF10, 0x81)]
    assert read(segment, link, 1, 0x2020, 3) == 2
    assert read(segment, link, 1, 0x1001) == 0x81
    # The dropped TPDOs are in the upper half; boards in C report the first at once.
    assert read(segment, link, 1, 0x1003, 1) in {0x0002_FF10, 0x0001_FF10}
    assert (segment.frames_sent, segment.frames_dropped) == (0, 2)
    for counter in range(2, 2 + WINDOWS_MET):
        assert read(segment, link, 1, 0x1001) == 0x81
        give(segment, link, sync(counter))
    segment.tick(2e6)
    assert [one["data"][:8].tobytes()[:5] for one in link.take_sent() if one["can_id"] == 0x81] == [b"\0\0\0\x10\xff"]


def test_only_a_tpdo_that_comes_back_unsent_is_a_missed_window(segment: Segment, link: ArrayLink) -> None:
    others = (frame(0x181, bytes(8), flags) for flags in (0, ECHO, ERROR))
    give(segment, link, frame(0, bytes((START, 1))), frame(0x701, b"\5", ECHO | ERROR), *others)
    segment.tick(1e6)
    assert 0x81 not in link.take_sent()["can_id"]
    assert (segment.frames_sent, segment.frames_dropped) == (0, 0)


def test_time_passes_in_steps_of_5_ms_but_not_while_a_sync_is_due(segment: Segment, link: ArrayLink) -> None:
    """Of 10 ms, from 7 ms after a SYNC until it is 20 ms late is no time for heartbeats."""
    assert write(segment, link, 0x1017, 0, 1, 2) == 0

    def beats_at(*now_ms: float) -> list[float]:
        found = []
        for each in now_ms:
            link.take_sent()
            segment.tick(each / 1000)
            found += [each] if 0x701 in link.take_sent()["can_id"] else []
        return found

    assert beats_at(1000, 1001, 1004.9, 1005, 1009, 1010.1) == [1000, 1005, 1010.1]
    give(segment, link, sync(1), now_s=2.0)
    assert beats_at(2000, 2004, 2005, 2006.9) == [2000, 2005]
    give(segment, link, sync(2), now_s=3.0)
    assert beats_at(3007.1, 3010, 3019.9) == []
    assert beats_at(3020.1, 3021, 3025.2) == [3020.1, 3025.2]


def test_remapping_changes_what_is_sent(segment: Segment, link: ArrayLink) -> None:
    pdo, mapping = 0x1800, 0x1A00
    assert write(segment, link, pdo, 1, 0xC000_0181, 4) == 0
    assert write(segment, link, mapping, 0, 0, 1) == 0
    assert write(segment, link, mapping, 1, 0x2100_080E, 4) == 0
    assert write(segment, link, mapping, 2, 0x1001_0008, 4) == 0
    assert write(segment, link, mapping, 0, 2, 1) == 0
    assert write(segment, link, pdo, 2, 1, 1) == 0
    assert write(segment, link, pdo, 6, 0, 1) == 0
    assert write(segment, link, pdo, 1, 0x4000_03A5, 4) == 0
    give(segment, link, frame(0, bytes((START, 1))))
    for counter in (1, 2, 3):
        answers = dict(give(segment, link, sync(counter)))
        assert 0x181 not in answers
        assert int.from_bytes(answers[0x3A5][:2], "little") & 0x3FFF == read(segment, link, 1, 0x2100, 8) & 0x3FFF
        assert len(answers[0x3A5]) == 3


@pytest.mark.parametrize(
    "given",
    [
        (0x1800, 9, 5, 1, 0x0609_0011),
        (0x1018, 1, 1, 4, 0x0601_0002),
        (0x1017, 0, 1, 4, 0x0607_0010),
        (0x5000, 0, 4, 1, 0x0602_0000),
    ],
)
def test_writes_are_refused_with_the_code_of_the_standard(
    segment: Segment, link: ArrayLink, given: tuple[int, int, int, int, int]
) -> None:
    index, sub, value, size, abort = given
    assert write(segment, link, index, sub, value, size) == abort


def test_segments_without_a_transfer_and_without_an_end_are_aborted(segment: Segment, link: ArrayLink) -> None:
    for stray in (0x60, 0x00):
        assert sdo(segment, link, 1, bytes((stray,)))[4:] == struct.pack("<I", 0x0504_0001)
    assert sdo(segment, link, 1, struct.pack("<BHBI", 0x21, 0x1017, 0, 1 << 30))[0] == 0x60
    answers = [sdo(segment, link, 1, bytes((place % 2 << 4, *range(7)))) for place in range(60)]
    taken = sum(answer[0] >> 5 == 1 for answer in answers)
    assert taken == 37  # 259 bytes
    assert answers[taken][4:] == struct.pack("<I", 0x0607_0012)
    assert {answer[4:] for answer in answers[taken + 1 :]} == {struct.pack("<I", 0x0504_0001)}


def test_frames_of_any_kind(segment: Segment, link: ArrayLink) -> None:
    """Random and mutated frames: no exception leaves the loop, and the nodes still work afterwards."""
    random = np.random.default_rng(11)
    real = np.concatenate([sync(1), frame(0x601, bytes.fromhex("4018100100000000")), frame(0, b"\1\0")])
    for _ in range(100):
        wild = np.frombuffer(random.bytes(400 * FRAME.itemsize), FRAME).copy()
        wild["can_id"] &= np.uint32(0x7FF)
        wild["flags"] &= random.choice(np.array([0, 0, REMOTE | EXTENDED, 0xFF], np.uint8), len(wild))
        wild["length"] = random.integers(0, 65, len(wild))
        wild["time_ns"] = random.integers(0, 2**50, len(wild))
        mutated = wild[::4]
        mutated[:] = real[random.integers(0, len(real), len(mutated))]
        mutated["data"][:, random.integers(0, 8)] ^= random.integers(0, 256, len(mutated)).astype(np.uint8)
        mutated["length"] = np.where(random.random(len(mutated)) < 0.5, mutated["length"], random.integers(0, 65))
        link.waiting.append(wild)
        segment.take(link.receive(), 0.0)
        segment.tick(random.uniform(0, 1e6))
        link.sent.clear()
        link.waiting.clear()
    give(segment, link, frame(0, bytes((RESET_NODE, 0))), frame(0, bytes((START, 0))))
    assert len(give(segment, link, frame(0x80, b"\1", time_ns=10**13))) == 8
