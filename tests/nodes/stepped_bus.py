"""Stepped nodes of one bus, their wire, a receiver, and a clock that the test moves."""

import struct

import numpy as np

from dbc.contract import Contract
from dbc.frame import Frames
from dbc.steps import (
    BAD,
    COUNT,
    LATE_SLOTS,
    SEQUENCE,
    SET,
    STEP,
    WORD_BYTES,
    Form,
    form_at,
    hash_of,
    kind_of,
    move,
    put,
    read_word,
)
from nodes.segment import Segment
from nodes.steps.boards import SteppedBoards
from nodes.virtual_boards import VirtualBoards
from skin.sources import Frame
from skin.sync_counter import SYNC_OVERFLOW
from tests.bus.harness import frame
from tests.layouts import STEPPED_SKIN
from tests.nodes.helpers import START, ArrayLink, abort_code, read_request, write_request

IDS = (1, 2, 3, 4)
#: From SYNC to SYNC, from slot to slot, and until all sums are set, a group in each slot, milliseconds.
PERIOD_MS = 100
SLOT_MS = round(1000 * STEPPED_SKIN.steps.slot_s)
SET_MS = 12 * SLOT_MS


class Press:
    """Nothing, then from a step on an even force on every taxel."""

    has_noise = False

    def __init__(self, contract: Contract, from_step: int = 10, force_n: float = 0.008) -> None:
        taxels = contract.layout.taxels
        shape = taxels.rows, taxels.columns
        self._from = from_step
        # Neighbours differ, so that all sums do.
        self.force_n = np.random.default_rng(5).uniform(0.5, 1.5, shape).astype(np.float32) * np.float32(force_n)

    def frame(self, step: int) -> Frame:
        is_on = step >= self._from
        return Frame(self.force_n if is_on else np.zeros_like(self.force_n), "thing" if is_on else "")


class Part:
    """What a receiver holds of one part.

    Attributes
    ----------
    kinds : list of int
        Of the words that came.
    gaps, different : int
        Words that told of a loss, and checks of other integers.
    missing : set of int
        Groups that are to be set.
    is_late : bool
        Whether the newest word was too old.
    """

    def __init__(self, form: Form, cycle: int) -> None:
        self.form, self._cycle = form, cycle
        self.known = np.zeros(form.sums, np.int64)
        self.kinds: list[int] = []
        self.gaps = self.different = self.sent = self.slot = 0
        self.missing, self.is_late, self._is_chained = set(range(form.groups)), False, False

    @property
    def is_whole(self) -> bool:
        """Whether all integers are those of the board."""
        return not self.missing and not self.is_late

    def take(self, byte: int, word: int, now: int | None = None) -> None:
        """Take a word in slot number `now`, or in time."""
        kind, part, sent, high, data = kind_of(word, self.form)
        assert kind != BAD
        self.kinds.append(kind)
        if kind == STEP:
            passed = (byte - 1 - self.slot) % SYNC_OVERFLOW
            if not self._is_chained or not 1 <= passed <= SEQUENCE or (self.sent + 1) % SEQUENCE != sent:
                self._lose(is_chained=False)
                return
            self.slot, self.sent = (self.slot + passed) % self._cycle, (self.sent + 1) % COUNT
            move(self.known, part, data, self.form)
        else:
            if not self._is_chained or (self.sent + 1) % COUNT != sent:
                self._lose(is_chained=True)
            self.slot, self.sent = (SYNC_OVERFLOW * high + byte - 1) % self._cycle, sent
            if kind == SET:
                put(self.known, part, data, self.form)
                self.missing.discard(part)
            elif not self.missing and data != hash_of(self.known):
                self.different += 1
                self.missing = set(range(self.form.groups))
        self.is_late = now is not None and (now - self.slot) % self._cycle > LATE_SLOTS

    def _lose(self, *, is_chained: bool) -> None:
        self.gaps += 1
        self._is_chained, self.missing = is_chained, set(range(self.form.groups))


class Receiver:
    """What a receiver of all frames holds of the parts of a skin."""

    def __init__(self, contract: Contract) -> None:
        self._table = contract.parts
        self.parts = [
            Part(form_at(self._table.form, part), contract.slot_cycle) for part in range(len(self._table.form))
        ]

    def take(self, sent: Frames, bus: int = 0) -> None:
        """Take frames, at once."""
        for one in sent:
            row = self._table.row_of[bus, one["can_id"]]
            if row < 0:
                continue
            assert one["length"] == self._table.length[row]
            for place in range(self._table.parts[row]):
                word = read_word(one["data"][1 + WORD_BYTES * place :])
                self.parts[self._table.part[row] + place].take(int(one["data"][0]), word)


class Bus:
    """Nodes 1 to 4 of bus0, the wire, a receiver, and a clock that the test moves."""

    def __init__(self, contract: Contract, **options: object) -> None:
        self.contract = contract
        self.source = Press(contract)
        self.blocks = [node.block for node in contract.on_bus(0) if node.node_id in IDS]
        self.boards = SteppedBoards(contract, self.blocks, self.source, noise_n=0.0, **options)  # type: ignore[arg-type]
        self.link = ArrayLink()
        self.complaints: list[str] = []
        nodes = VirtualBoards(contract, 0, IDS, self.boards)
        self.segment = Segment(contract, 0, nodes, self.boards, self.link.send, complain=self.complaints.append)
        self.now_s = 100.0
        self.received = Receiver(contract)
        self._sync_ms = self._counter = 0
        self.segment.boot(self.now_s)
        self.link.take_sent()

    def give(self, *arrived: Frames) -> Frames:
        """Let frames arrive, and return what the nodes answer at once."""
        self.link.take_sent()
        self.link.waiting.extend(arrived)
        self.segment.take(self.link.receive(), self.now_s)
        return self.link.take_sent()

    def tick(self) -> Frames:
        """Go on by a millisecond, with a SYNC each 100 from the first on, and return the frames of sums."""
        self.now_s += 1e-3
        if self._counter:
            self._sync_ms += 1
            if self._sync_ms == PERIOD_MS:
                self.sync()
        self.segment.tick(self.now_s)
        return self.sums_of(self.link.take_sent())

    def run(self, ticks: int) -> Frames:
        """Go on by `ticks` milliseconds; every frame arrives. Return frames of sums, which the receiver has taken."""
        sent = []
        for _ in range(ticks):
            self.segment.take(self.link.receive(), self.now_s)
            sent.append(self.tick())
        self.segment.take(self.link.receive(), self.now_s)
        together = np.concatenate(sent)
        self.received.take(together)
        return together

    def start(self) -> None:
        self.give(frame(0, bytes((START, 0))))

    def begin(self) -> None:
        """Start the nodes, and send the first SYNC."""
        self.start()
        self.sync()

    def sync(self, counter: int | None = None) -> None:
        self._counter, self._sync_ms = counter or self._counter % SYNC_OVERFLOW + 1, 0
        self.give(frame(0x80, bytes((self._counter,)), time_ns=round(self.now_s * 1e9)))

    def sdo(self, node_id: int, request: bytes) -> bytes:
        answers = self.give(frame(0x600 + node_id, request.ljust(8, b"\0")))
        (answer,) = answers[answers["can_id"] == 0x580 + node_id]
        return answer["data"][:8].tobytes()

    def write(self, index: int, sub: int, data: bytes, node_id: int = 1) -> int:
        return abort_code(self.sdo(node_id, write_request(index, sub, data)))

    def read(self, index: int, sub: int = 0, node_id: int = 1) -> bytes:
        answer = self.sdo(node_id, read_request(index, sub))
        assert answer[0] & 0xE0 == 0x40, answer.hex()
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        return self.sdo(node_id, b"\x60")[1:]  # seven bytes come in one segment

    def read_real(self, index: int, sub: int = 0, node_id: int = 1) -> float:
        return float(struct.unpack("<f", self.read(index, sub, node_id))[0])

    def sums_of(self, sent: Frames) -> Frames:
        """Return the frames of sums."""
        frames: Frames = sent[self.contract.parts.row_of[0][sent["can_id"]] >= 0]
        return frames

    def parts_of(self, block: int) -> list[Part]:
        """Return what the receiver holds of a block."""
        return [self.received.parts[part] for part in np.flatnonzero(self.contract.parts.block == block)]

    def known(self, block: int) -> list[int]:
        """Return the integers that the board of a block believes its receivers to hold."""
        rows = self.boards.senders.state.known[self.contract.parts.block == block]
        return [int(each) for row in rows for each in row]


def back(sent: Frames, flags: int) -> Frames:
    returned = sent.copy()
    returned["flags"] |= flags
    return returned
