"""What goes to boards in C and comes from them, with stand-ins for the boards: no compiler is needed."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from bus.link import DISCARDED
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames, frames
from nodes.adaptive.firmware import AdaptiveFirmwareSegment, FirmwarePatches
from nodes.firmware_segment import FirmwareSegment
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.firmware.twins import Wire, small_contract
from tests.nodes.links import Still

MS = 1_000_000


class Recorder:
    """Boards that write down what they get, and answer with `answer`."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []
        self.counts: list[npt.NDArray[np.uint16] | None] = []
        self.answer: Frames = frames(0)
        self.is_sending = False

    def power_up(self, now_s: float) -> Frames:
        self.calls.append(("power up", now_s))
        return frame(0x701, b"\0")

    def take(self, arrived: Frames, now_s: float, counts: npt.NDArray[np.uint16] | None = None) -> Frames:
        self.calls.append(("take", ([int(each) for each in arrived["can_id"]], now_s)))
        self.counts.append(counts)
        return self.answer

    def pass_time(self, now_s: float) -> Frames:
        self.calls.append(("pass time", now_s))
        return self.answer

    def refuse(self, refused: Frames) -> None:
        self.calls.append(("refuse", refused["can_id"].tolist()))

    def choose(self, most: int, now_ns: int, until_ns: int) -> Frames:
        self.calls.append(("choose", (most, now_ns, until_ns)))
        return self.answer

    def taken(self) -> list[tuple[str, Any]]:
        calls, self.calls = self.calls, []
        return calls


class Compiled:
    """Firmware of nodes 1 and 2 of a bus."""

    def __init__(self) -> None:
        self.recorder = Recorder()

    def boards(self, bus: int) -> Recorder:
        assert bus == 1
        return self.recorder

    def node_ids(self, bus: int) -> frozenset[int]:
        assert bus == 1
        return frozenset((1, 2))


class Sampled:
    """A sampler that says what it was asked for, by what it returns."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, int, int]] = []

    def sample(self, counter: int, time_ns: int, bus: int) -> npt.NDArray[np.int32]:
        self.asked.append((counter, time_ns, bus))
        return np.full((1, 128), 100 + counter, np.int32)


class Bus:
    """Two boards of the second bus of a small skin, with a SYNC every 10 ms."""

    def __init__(self) -> None:
        self.wire, self.firmware, self.sampler = Wire(), Compiled(), Sampled()
        self.boards = self.firmware.recorder
        self.complaints: list[str] = []
        contract: Contract = small_contract()
        self.pdos = [tpdo.cob_id for node in contract.on_bus(1) for tpdo in node.tpdos]
        self.segment = FirmwareSegment(
            contract,
            1,
            self.firmware,  # type: ignore[arg-type]
            self.wire.send,
            self.sampler,  # type: ignore[arg-type]
            complain=self.complaints.append,
        )

    def take(self, *arrived: Frames, now_s: float = 5.0) -> list[Any]:
        """Let frames arrive; return the identifiers of those that the boards got, call by call."""
        self.segment.take(np.concatenate(arrived), now_s)
        return [given[0] for name, given in self.boards.taken() if name == "take"]


@pytest.fixture
def bus() -> Bus:
    return Bus()


def sync(data: bytes = b"\7", flags: int = 0) -> Frames:
    return frame(0x80, data, flags, time_ns=40 * MS)


def test_boards_boot_when_they_are_told_the_time(bus: Bus) -> None:
    bus.segment.boot(12.5)
    assert bus.boards.taken() == [("power up", 12.5)]
    assert [each[0] for each in bus.wire.take()] == [0x701]
    assert bus.segment.frames_sent == 0  # a boot-up message is no TPDO


def test_frames_up_to_a_sync_go_to_the_boards_together_and_the_others_after_it(bus: Bus) -> None:
    first, second = frame(0x601, bytes(8)), frame(0x602, bytes(8))
    assert bus.take(first, second) == [[0x601, 0x602]]
    assert bus.boards.counts == [None]
    assert bus.take(first, sync(), second, sync(b"\x08")) == [[0x601, 0x80], [0x602, 0x80]]
    assert bus.take(sync(), first) == [[0x80], [0x601]]
    assert bus.take(sync()) == [[0x80]]
    assert bus.sampler.asked == [(7, 40 * MS, 1), (8, 40 * MS, 1), (7, 40 * MS, 1), (7, 40 * MS, 1)]
    assert (bus.segment.syncs_seen, bus.segment.sync_at_s) == (4, 5.0)


def test_at_a_sync_the_boards_get_what_the_taxels_read(bus: Bus) -> None:
    bus.take(sync())
    (counts,) = bus.boards.counts
    assert counts is not None
    assert counts.dtype == np.uint16
    assert (counts == 107).all()


@pytest.mark.parametrize(
    ("data", "counter"), [(b"\1", 1), (b"\xf0", 240), (b"", 0), (b"\7\7", 0), (b"\0", None), (b"\xf1", None)]
)
def test_a_sync_has_a_counter_from_1_to_240_or_none(bus: Bus, data: bytes, counter: int | None) -> None:
    assert bus.take(sync(data)) == [[0x80]]  # the boards judge it, too
    assert [asked for asked, *_ in bus.sampler.asked] == ([] if counter is None else [counter])
    assert bus.segment.syncs_seen == (counter is not None)


@pytest.mark.parametrize("flags", [ERROR, EXTENDED, REMOTE, ECHO])
def test_what_only_looks_like_a_sync_or_a_heartbeat_is_none(bus: Bus, flags: int) -> None:
    assert bus.take(sync(flags=flags), frame(0x701, b"\5", flags)) == [[0x80, 0x701]]
    assert (bus.sampler.asked, bus.segment.syncs_seen, bus.complaints) == ([], 0, [])


def test_a_heartbeat_of_an_own_node_id_is_told(bus: Bus) -> None:
    bus.take(frame(0x702, b"\5"), frame(0x703, b"\5"), frame(0x700, b"\5"))
    assert bus.complaints == ["node-ID 2 is on bus1 twice"]


def test_tpdos_are_counted_when_they_are_accepted_refused_or_given_up(bus: Bus) -> None:
    assert bus.pdos == [0x181, 0x281, 0x182, 0x282]
    sent = np.concatenate([frame(can_id, bytes(8)) for can_id in (0x181, 0x581, 0x281, 0x182, 0x582, 0x282)])
    bus.boards.answer, bus.wire.room = sent, 3
    bus.segment.take(sync(), 5.0)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (2, 2)
    assert bus.boards.taken()[1:] == [("refuse", [0x182, 0x582, 0x282])]
    bus.boards.answer = frames(0)
    unsent = [frame(can_id, bytes(8), DISCARDED) for can_id in (0x181, 0x701)]
    others = [frame(can_id, bytes(8), flags) for can_id in (0x281,) for flags in (0, ECHO, ERROR)]
    bus.take(*unsent, *others)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (1, 3)


def test_nothing_is_sent_where_boards_have_nothing_to_say(bus: Bus) -> None:
    bus.take(frame(0x601, bytes(8)))
    assert bus.wire.sent == []


def test_time_passes_in_steps_of_5_ms_but_not_while_a_sync_is_due(bus: Bus) -> None:
    """Of 10 ms, from 7 ms after a SYNC until it is 20 ms late is no time for heartbeats."""

    def passed(*now_ms: float) -> list[float]:
        before = len(bus.boards.calls)
        for each in now_ms:
            bus.segment.tick(each / 1000)
        return [round(1000 * now_s, 3) for name, now_s in bus.boards.calls[before:] if name == "pass time"]

    assert passed(0, 1, 4.9, 5, 9, 10.1) == [0, 5, 10.1]
    bus.take(sync(), now_s=1.0)
    assert passed(1000, 1004, 1005, 1006.9) == [1000, 1005]
    bus.take(sync(), now_s=2.0)
    assert passed(2007.1, 2010, 2019.9) == []
    assert passed(2020.1, 2021, 2025.2) == [2020.1, 2025.2]


class Patches:
    """All adaptive boards of a process, of which those of one bus write down what they get."""

    def __init__(self) -> None:
        self.recorder = Recorder()
        self.decision, self.has_due, self.pace_ns = 0, False, 1e6
        self.advanced: list[float] = []
        self.touched: list[int] = []

    def on_bus(self, _: int) -> Recorder:
        return self.recorder

    def node_ids(self, _: int) -> frozenset[int]:
        return frozenset((1,))

    def advance(self, now_s: float) -> None:
        self.advanced.append(now_s)

    def touched_from(self, time_ns: int) -> None:
        self.touched.append(time_ns)


class AdaptiveBus:
    def __init__(self) -> None:
        self.wire, self.patches = Wire(), Patches()
        self.boards = self.patches.recorder
        contract = Contract.from_layout(load_layout(Path("adaptive")))
        self.cob_id = contract.on_bus(0)[0].adaptive_tpdos[0].cob_id
        self.segment = AdaptiveFirmwareSegment(contract, 0, self.wire.send, self.patches, complain=lambda _: None)  # type: ignore[arg-type]

    def tick(self, now_ms: float) -> list[str]:
        self.segment.tick(now_ms / 1000)
        return [name for name, _ in self.boards.taken()]


def test_adaptive_boards_sample_in_each_turn_and_send_once_for_each_decision_that_has_news() -> None:
    bus = AdaptiveBus()
    assert bus.tick(1000) == ["pass time"]
    assert bus.tick(1001) == []
    bus.patches.decision = 1
    assert bus.tick(1002) == []  # nothing is due
    bus.patches.has_due = True
    assert bus.tick(1003) == []  # decided already
    bus.patches.decision = 2
    bus.segment.tick(1.004)
    # 1 ms holds 8 classic frames of 135 bits at 1 Mbit/s, rounded up; four more are spare.
    assert bus.boards.taken() == [("choose", (12, 1004 * MS, 1005 * MS))]
    assert bus.tick(1004.5) == []
    assert bus.tick(1005) == ["pass time"]
    assert bus.patches.advanced == [1.0, 1.001, 1.002, 1.003, 1.004, 1.0045, 1.005]


def test_adaptive_boards_leave_the_bus_to_others_after_a_sync() -> None:
    bus = AdaptiveBus()
    bus.patches.has_due, bus.patches.decision = True, 1
    bus.segment.take(frame(0x80, b"\3", time_ns=1000 * MS), 1.0)
    bus.boards.taken()
    assert "choose" not in bus.tick(1001)
    bus.patches.decision = 2
    assert "choose" in bus.tick(1002)


def test_the_first_sync_tells_when_the_touch_began() -> None:
    bus = AdaptiveBus()
    period_ns = 100 * MS
    for data in (b"\3", b"\1", b""):
        bus.segment.take(frame(0x80, data, time_ns=1000 * MS), 1.0)
    assert bus.patches.touched == [1000 * MS - 2 * period_ns, 1000 * MS, 1000 * MS]


def test_adaptive_tpdos_count_when_their_echoes_come() -> None:
    bus = AdaptiveBus()
    own = [frame(bus.cob_id, bytes(8), flags) for flags in (0, ECHO, ECHO, DISCARDED, ERROR)]
    bus.segment.take(np.concatenate([*own, frame(0x701, b"\5", ECHO)]), 1.0)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (2, 0)
    bus.boards.answer, bus.wire.room = np.concatenate(own[:3]), 1
    bus.segment.take(frame(0x601, bytes(8)), 1.0)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (2, 2)


class Counted:
    """Adaptive boards of one bus that keep the counts they get, and are ready after so many samples."""

    def __init__(self, bus: int, ready_after: int) -> None:
        self.bus, self.left = bus, ready_after
        self.counts: list[npt.NDArray[np.uint16]] = []
        self.decisions: list[tuple[int, int]] = []
        self.is_sending = self.has_due = False

    def take_counts(self, counts: npt.NDArray[np.uint16]) -> bool:
        self.counts.append(counts.copy())
        self.left -= 1
        return self.left <= 0

    def decide(self, skipped: int, passed_ns: int) -> bool:
        self.decisions.append((skipped, passed_ns))
        return self.has_due

    def sums(self, board: int, size: int) -> npt.NDArray[np.int32]:
        return 1000 * self.bus + 100 * board + np.arange(size, dtype=np.int32)


class AdaptiveFirmware:
    def __init__(self) -> None:
        self.boards = {0: Counted(0, 3), 1: Counted(1, 5)}

    def adaptive_boards(self, bus: int) -> Counted:
        return self.boards[bus]

    def node_ids(self, bus: int) -> frozenset[int]:
        return frozenset((10 + bus,))


@pytest.fixture
def patches() -> tuple[FirmwarePatches, dict[int, Counted], list[int]]:
    """Two boards of the first bus and one of the second, which have learned, and their blocks."""
    contract = Contract.from_layout(load_layout(Path("adaptive")))
    blocks = [contract.on_bus(0)[0].block, contract.on_bus(0)[2].block, contract.on_bus(1)[1].block]
    firmware = AdaptiveFirmware()
    made = FirmwarePatches(contract, blocks, Still(contract), firmware)  # type: ignore[arg-type]
    return made, firmware.boards, blocks


Made = tuple[FirmwarePatches, dict[int, Counted], list[int]]


def test_boards_sample_until_all_have_learned(patches: Made) -> None:
    made, boards, _ = patches
    assert [len(each.counts) for each in boards.values()] == [5, 5]
    assert {bus: each.counts[0].shape for bus, each in boards.items()} == {0: (2, 32), 1: (1, 32)}
    assert boards[0].counts[0].dtype == np.uint16
    assert made.decision == 0
    assert [made.on_bus(bus) for bus in (0, 1)] == list(boards.values())
    assert made.node_ids(1) == {11}


def test_boards_get_the_samples_of_their_own_taxels(patches: Made) -> None:
    made, boards, blocks = patches
    made.touched_from(0)
    made.advance(100.0)
    for rows, bus in (([0, 1], 0), ([2], 1)):
        for row, mine in zip(rows, boards[bus].counts[-1], strict=True):
            assert mine.tolist() == made.counts(blocks[row]).tolist()
    assert made.counts(blocks[0]).any()


def test_boards_decide_once_for_the_samples_of_a_turn(patches: Made) -> None:
    made, boards, _ = patches
    made.advance(100.0)
    made.advance(100.004)
    made.advance(100.104)  # a hundred samples late: twenty are taken
    assert boards[0].decisions == boards[1].decisions == [(0, 0), (0, 4_000_000), (80, 100_000_000)]
    assert [len(each.counts) for each in boards.values()] == [5 + 1 + 4 + 20] * 2
    assert made.decision == 1 + 4 + 100
    for bus in (0, 1):
        assert not made.has_due
        boards[bus].has_due = True
        made.advance(100.2 + bus)
        assert made.has_due
        boards[bus].has_due = False
        made.advance(100.3 + bus)


def test_any_board_may_hold_frames(patches: Made) -> None:
    made, boards, _ = patches
    assert not made.is_sending
    for each in boards.values():
        each.is_sending = True
        assert made.is_sending
        each.is_sending = False
    assert not made.is_sending


def test_sums_of_boards_stand_at_their_blocks(patches: Made) -> None:
    made, _, blocks = patches
    found = made.sums.reshape(-1, 32)
    for block, first in zip(blocks, (0, 100, 1000), strict=True):
        assert found[block].tolist() == list(range(first, first + 32))
    assert not np.delete(found, blocks, axis=0).any()
