"""What nodes are tested with in place of a bus and of a touch."""

import struct
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from nodes.electronics import Electronics
from nodes.firmware.library import Firmware
from nodes.sampler import CountSampler, Sampler
from nodes.segment import Boards, Segment
from nodes.virtual_boards import VirtualBoards
from skin.sources import Frame
from tests.bus.harness import frame

START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
MILLISECOND_NS = 1_000_000


class ArrayLink:
    """Keeps what nodes send, and echoes it as a bus without traffic would.

    What is tested here is what nodes make of frames, not a bus.
    """

    def __init__(self) -> None:
        self.sent: list[Frames] = []
        self.waiting: list[Frames] = []
        #: Frames that a send finds room for.
        self.room = 1 << 30

    def receive(self) -> Frames:
        arrived = np.concatenate(self.waiting) if self.waiting else frames(0)
        self.waiting.clear()
        return arrived

    def send(self, burst: Frames) -> int:
        taken = burst[: self.room].copy()
        self.sent.append(taken)
        echo = taken.copy()
        echo["flags"] |= ECHO
        self.waiting.append(echo)
        return len(taken)

    def take_sent(self) -> Frames:
        out = np.concatenate(self.sent) if self.sent else frames(0)
        self.sent.clear()
        return out


class Still:
    """A source with the same touch for ever."""

    has_noise = True

    def __init__(self, contract: Contract) -> None:
        taxels = contract.layout.taxels
        random = np.random.default_rng(1)
        self.force_n = random.uniform(0, taxels.force_max_n, (taxels.rows, taxels.columns)).astype(np.float32)

    def frame(self, step: int) -> Frame:
        return Frame(self.force_n, "")


def new_sampler(contract: Contract) -> Sampler:
    """Return a sampler of the same touch for ever, without noise."""
    return Sampler(contract.phi, Still(contract), Electronics(contract.layout.taxels, noise_n=0.0))


def new_segment(
    contract: Contract,
    link: ArrayLink,
    node_ids: Collection[int],
    *,
    sampler: Sampler | None = None,
    complain: Callable[[str], None] = lambda _: None,
    store: Path | None = None,
    unnumbered: bool = False,
    in_c: bool = False,
) -> Segment:
    """Return nodes of bus0, booted; in C the first four."""
    boards: Boards
    if in_c:
        boards = Firmware(contract, contract.on_bus(0)[:4], store=store).boards(0)
        sampler = CountSampler(contract.phi, Still(contract), Electronics(contract.layout.taxels, noise_n=0.0))
    else:
        sampler = sampler or new_sampler(contract)
        boards = VirtualBoards(contract, 0, node_ids, sampler, store=store, unnumbered=unnumbered)
    built = Segment(contract, 0, boards, sampler, link.send, complain=complain)
    built.boot(0.0)
    return built


def give(segment: Segment, link: ArrayLink, *arrived: Frames, now_s: float = 0.0) -> list[tuple[int, bytes]]:
    """Let frames arrive; return what the nodes sent, as (identifier, payload)."""
    link.take_sent()
    link.waiting.extend(arrived)
    segment.take(link.receive(), now_s)
    return [(int(one["can_id"]), one["data"][: one["length"]].tobytes()) for one in link.take_sent()]


def sync(counter: int) -> Frames:
    return frame(0x80, bytes((counter,)), time_ns=counter * 10 * MILLISECOND_NS)


def sdo(segment: Segment, link: ArrayLink, node_id: int, request: bytes) -> bytes:
    answers = give(segment, link, frame(0x600 + node_id, request.ljust(8, b"\0")))
    assert [can_id for can_id, _ in answers] == [0x580 + node_id]
    return answers[0][1]


def write_request(index: int, subindex: int, data: bytes) -> bytes:
    """Return the SDO request that writes up to four bytes."""
    return struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")


def read_request(index: int, subindex: int = 0) -> bytes:
    """Return the SDO request that reads an object."""
    return struct.pack("<BHB4x", 0x40, index, subindex)


def abort_code(answer: bytes) -> int:
    """Return the abort code of an answer of SDO, 0 for none."""
    return int(struct.unpack("<I", answer[4:])[0]) if answer[0] == 0x80 else 0


def write(segment: Segment, link: ArrayLink, index: int, sub: int, value: int, size: int) -> int:
    """Write to node 1 by expedited SDO; return the abort code, 0 for none."""
    return abort_code(sdo(segment, link, 1, write_request(index, sub, value.to_bytes(size, "little"))))


def read(segment: Segment, link: ArrayLink, node_id: int, index: int, sub: int = 0) -> int:
    answer = sdo(segment, link, node_id, read_request(index, sub))
    assert answer[0] & 0xE0 == 0x40, answer.hex()
    return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little")
