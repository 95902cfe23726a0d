"""Synchronous nodes that recognise first: which state's PDOs answer a SYNC, and within which window."""

from pathlib import Path

import pytest

from dbc.contract import Contract
from dbc.frame import Frames
from nodes.segment import Segment
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.layouts import in_one_instant
from tests.nodes.helpers import ArrayLink, give, new_segment, read, sync, write

START, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = (frame(0, bytes((code, 0))) for code in (1, 128, 129, 130))
TO_RECOGNITION, TO_IMAGES = frame(0xFF, b"\0"), frame(0xFF, b"\1")
#: The only PDO of recognition of nodes 1 and 2, and the first of images.
FEW, FIRST_IMAGE = {0x1A1, 0x1A2}, {0x181, 0x182}


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout(Path("recognise-first")))


@pytest.fixture
def segment(contract: Contract, link: ArrayLink) -> Segment:
    return new_segment(contract, link, {1, 2})


def answers(segment: Segment, link: ArrayLink, *arrived: Frames) -> set[int]:
    return {can_id for can_id, _ in give(segment, link, *arrived)}


def is_images(sent: set[int]) -> bool:
    assert sent == FEW or (len(sent) == 32 and sent.isdisjoint(FEW) and sent > FIRST_IMAGE)
    return sent != FEW


def test_a_switch_holds_from_the_next_sync_on(segment: Segment, link: ArrayLink) -> None:
    assert not is_images(answers(segment, link, START, sync(1)))
    assert answers(segment, link, TO_IMAGES) == set()
    assert [node.active_state for node in segment.boards.nodes] == [0, 0]
    assert is_images(answers(segment, link, sync(2)))
    assert is_images(answers(segment, link, sync(3), TO_RECOGNITION))
    assert not is_images(answers(segment, link, sync(4)))


@pytest.mark.parametrize("data", [b"", b"\1\0", b"\1\1", b"\2", b"\xff"])
def test_a_switch_is_one_byte_of_0_or_1(segment: Segment, link: ArrayLink, data: bytes) -> None:
    assert not is_images(answers(segment, link, START, frame(0xFF, data), sync(1)))
    assert is_images(answers(segment, link, TO_IMAGES, frame(0xFF, data), sync(2)))


def test_only_operational_nodes_take_a_switch(segment: Segment, link: ArrayLink) -> None:
    assert not is_images(answers(segment, link, TO_IMAGES, START, sync(1)))
    assert read(segment, link, 1, 0x2008, 1) == 0
    assert not is_images(answers(segment, link, PRE_OPERATIONAL, TO_IMAGES, START, sync(2)))


@pytest.mark.parametrize("reset", [RESET_NODE, RESET_COMMUNICATION])
def test_a_reset_returns_to_recognition(segment: Segment, link: ArrayLink, reset: Frames) -> None:
    assert is_images(answers(segment, link, START, TO_IMAGES, sync(1)))
    give(segment, link, reset)
    assert [node.active_state for node in segment.boards.nodes] == [0, 0]
    assert not is_images(answers(segment, link, START, sync(2)))


def test_the_state_of_one_node_can_be_written_and_read(segment: Segment, link: ArrayLink) -> None:
    assert read(segment, link, 1, 0x2008, 0) == 2
    assert write(segment, link, 0x2008, 1, 2, 1) == 0x0609_0030
    assert write(segment, link, 0x2008, 1, 1, 1) == 0
    assert [read(segment, link, node_id, 0x2008, 1) for node_id in (1, 2)] == [1, 0]
    sent = answers(segment, link, START, sync(1))
    assert len(sent) == 17
    assert {0x181, 0x1A2} < sent
    assert not sent & {0x1A1, 0x182}


def test_the_window_is_that_of_the_state(segment: Segment, link: ArrayLink) -> None:
    """99 % of the shorter period in recognition; a classic frame of 7 bytes lasts 125 µs at most."""
    give(segment, link, START)
    for switch, window_us in ((TO_RECOGNITION, 4950), (TO_IMAGES, 39_600), (TO_RECOGNITION, 4950)):
        give(segment, link, switch)
        link.waiting.append(sync(7))
        segment.take(link.receive(), 0.0)
        assert set((link.take_sent()["expires_ns"] - 70_000_000).tolist()) == {(window_us - 125) * 1000}


def test_the_few_sums_are_those_that_their_mapping_names(segment: Segment, link: ArrayLink) -> None:
    """The mapping says which, in the order of the bits."""
    payload = dict(give(segment, link, START, sync(1)))[0x1A1]
    entries = [read(segment, link, 1, 0x1A10, place) for place in range(1, read(segment, link, 1, 0x1A10, 0) + 1)]
    assert entries[0] == 0x2022_00_08
    assert payload[0] == 1
    packed = shift = 0
    for entry in entries:
        packed |= read(segment, link, 1, entry >> 16, entry >> 8 & 0xFF) << shift
        shift += entry & 0xFF
    assert packed.to_bytes(len(payload), "little") == payload


def test_nodes_without_states_take_no_switch(link: ArrayLink) -> None:
    nodes = new_segment(Contract.from_layout(in_one_instant()), link, {1})
    give(nodes, link, START, TO_IMAGES, sync(1))
    assert nodes.boards.nodes[0].active_state == 0
    assert answers(nodes, link, sync(2)) == {0x181, 0x281}
