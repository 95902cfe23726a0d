"""Frames to nodes of a segment, and their answers."""

import struct

from dbc.frame import Frames
from nodes.segment import Segment
from tests.bus.harness import frame
from tests.nodes.links import ArrayLink

START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
MILLISECOND_NS = 1_000_000


def give(segment: Segment, link: ArrayLink, *arrived: Frames, now_s: float = 0.0) -> list[tuple[int, bytes]]:
    """Let frames arrive; return what the nodes sent, as (identifier, payload)."""
    link.take_sent()
    link.waiting.extend(arrived)
    segment.take(link.receive(), now_s)
    return [(int(one["can_id"]), one["data"][: one["length"]].tobytes()) for one in link.take_sent()]


def sync(cycle: int) -> Frames:
    return frame(0x80, b"", time_ns=cycle * 10 * MILLISECOND_NS)


def numbered_sync(counter: int) -> Frames:
    return frame(0x80, bytes((counter,)), time_ns=counter * 10 * MILLISECOND_NS)


def sdo(segment: Segment, link: ArrayLink, node_id: int, request: bytes) -> bytes:
    answers = give(segment, link, frame(0x600 + node_id, request.ljust(8, b"\0")))
    assert [can_id for can_id, _ in answers] == [0x580 + node_id]
    return answers[0][1]


def write(segment: Segment, link: ArrayLink, index: int, sub: int, value: int, size: int) -> int:
    """Write to node 1 by expedited SDO; return the abort code, 0 for none."""
    request = struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub) + value.to_bytes(4, "little")
    answer = sdo(segment, link, 1, request)
    return int(struct.unpack("<I", answer[4:])[0]) if answer[0] == 0x80 else 0


def read(segment: Segment, link: ArrayLink, node_id: int, index: int, sub: int = 0) -> int:
    answer = sdo(segment, link, node_id, struct.pack("<BHB", 0x40, index, sub))
    assert answer[0] & 0xE0 == 0x40, answer.hex()
    return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little")
