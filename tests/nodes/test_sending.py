"""What a segment passes to its boards and from them to the bus, with stand-ins for the boards."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from bus.link import DISCARDED
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames, frames
from nodes.segment import Segment
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.nodes.firmware.twins import Wire, small_contract

MS = 1_000_000


class Recorder:
    """Boards that write down what they get, and answer with `news`."""

    due_s = float("-inf")

    def __init__(self, contract: Contract, bus: int) -> None:
        nodes = contract.on_bus(bus)
        self.calls: list[tuple[str, Any]] = []
        self.measured: list[npt.NDArray[np.int32] | None] = []
        self.news: Frames = frames(0)
        self.node_ids = {node.node_id for node in nodes[:2]}
        self.is_pdo = np.zeros(0x800, np.bool_)
        for node in nodes:
            self.is_pdo[[tpdo.cob_id for tpdo in node.tpdos]] = True

    def power_up(self, now_s: float) -> Frames:
        self.calls.append(("power up", now_s))
        return frame(0x701, b"\0")

    def take(self, arrived: Frames, now_s: float) -> Frames:
        self.calls.append(("take", ([int(each) for each in arrived["can_id"]], now_s)))
        return self.news

    def answer(self, sync: Frames, now_s: float, measured: npt.NDArray[np.int32] | None) -> Frames:
        self.measured.append(measured)
        return self.take(sync, now_s)

    def pass_time(self, now_s: float) -> Frames:
        self.calls.append(("pass time", now_s))
        return self.news

    def refuse(self, refused: Frames) -> None:
        self.calls.append(("refuse", refused["can_id"].tolist()))

    def choose(self, now_ns: int) -> Frames:
        self.calls.append(("choose", now_ns))
        return self.news

    def taken(self) -> list[tuple[str, Any]]:
        calls, self.calls = self.calls, []
        return calls


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
        contract = small_contract()
        self.wire, self.boards, self.sampler = Wire(), Recorder(contract, 1), Sampled()
        self.complaints: list[str] = []
        self.pdos = [tpdo.cob_id for node in contract.on_bus(1) for tpdo in node.tpdos]
        complain = self.complaints.append
        self.segment = Segment(contract, 1, self.boards, self.sampler, self.wire.send, complain=complain)  # type: ignore[arg-type]

    def take(self, *arrived: Frames, now_s: float = 5.0) -> list[Any]:
        """Let frames arrive; return the identifiers of those that the boards got, call by call."""
        self.segment.take(np.concatenate(arrived), now_s)
        return [given[0] for name, given in self.boards.taken() if name == "take"]


@pytest.fixture
def bus() -> Bus:
    return Bus()


def sync(data: bytes = b"\7", flags: int = 0) -> Frames:
    return frame(0x80, data, flags, time_ns=40 * MS)


def test_frames_go_to_the_boards_in_their_order_and_a_sync_alone(bus: Bus) -> None:
    first, second = frame(0x601, bytes(8)), frame(0x602, bytes(8))
    assert bus.take(first, second) == [[0x601, 0x602]]
    assert bus.sampler.asked == []
    assert bus.take(first, sync(), second, sync(b"\x08")) == [[0x601], [0x80], [0x602], [0x80]]
    assert bus.take(sync(), first) == [[0x80], [0x601]]
    assert bus.take(sync()) == [[0x80]]
    assert bus.sampler.asked == [(7, 40 * MS, 1), (8, 40 * MS, 1), (7, 40 * MS, 1), (7, 40 * MS, 1)]
    assert (bus.segment.syncs_seen, bus.segment.sync_at_s) == (4, 5.0)


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
    bus.boards.news, bus.wire.room = sent, 3
    bus.segment.take(sync(), 5.0)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (2, 2)
    assert bus.boards.taken()[1:] == [("refuse", [0x182, 0x582, 0x282])]
    bus.boards.news = frames(0)
    unsent = [frame(can_id, bytes(8), DISCARDED) for can_id in (0x181, 0x701)]
    others = [frame(can_id, bytes(8), flags) for can_id in (0x281,) for flags in (0, ECHO, ERROR)]
    bus.take(*unsent, *others)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (1, 3)


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
    """All stepped boards of a process, of which those of one bus write down what they get."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.syncs: list[tuple[int, int, int]] = []
        self.advanced: list[float] = []
        self.touched: list[int] = []

    def choose(self, bus: int, now_ns: int) -> Frames:
        assert bus == 0
        return self._recorder.choose(now_ns)

    def take_sync(self, bus: int, counter: int, time_ns: int) -> None:
        self.syncs.append((bus, counter, time_ns))

    def take_echoes(self, bus: int, arrived: Frames) -> tuple[int, int]:
        return 7, int((arrived["flags"] & ECHO == 0).sum())

    def advance(self, now_s: float) -> None:
        self.advanced.append(now_s)

    def touched_from(self, time_ns: int) -> None:
        self.touched.append(time_ns)


class SteppedBus:
    def __init__(self) -> None:
        contract = Contract.from_layout(load_layout(Path("steps")))
        self.wire, self.boards = Wire(), Recorder(contract, 0)
        self.patches = Patches(self.boards)
        self.cob_id = contract.on_bus(0)[0].tpdos[0].cob_id
        self.segment = Segment(contract, 0, self.boards, self.patches, self.wire.send, complain=lambda _: None)  # type: ignore[arg-type]

    def tick(self, now_ms: float) -> list[str]:
        self.segment.tick(now_ms / 1000)
        return [name for name, _ in self.boards.taken()]


def test_stepped_boards_sample_and_send_in_each_turn() -> None:
    bus = SteppedBus()
    assert bus.tick(1000) == ["pass time", "choose"]
    assert bus.tick(1001) == ["choose"]
    bus.segment.tick(1.004)
    assert bus.boards.taken() == [("choose", 1004 * MS)]
    assert bus.tick(1005) == ["pass time", "choose"]
    assert bus.patches.advanced == [1.0, 1.001, 1.004, 1.005]


def test_the_first_sync_tells_when_the_touch_began() -> None:
    bus = SteppedBus()
    period_ns = 100 * MS
    for data in (b"\3", b"\1", b""):
        bus.segment.take(frame(0x80, data, time_ns=1000 * MS), 1.0)
    assert bus.patches.touched == [1000 * MS - 2 * period_ns, 1000 * MS, 1000 * MS]
    assert bus.patches.syncs == [(0, counter, 1000 * MS) for counter in (3, 1, 0)]


def test_stepped_tpdos_count_when_their_echoes_come() -> None:
    bus = SteppedBus()
    bus.segment.take(frame(bus.cob_id, bytes(8), ECHO), 1.0)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (7, 0)
    assert bus.boards.taken() == []  # there are no others
    bus.boards.news, bus.wire.room = np.concatenate([frame(bus.cob_id, bytes(8))] * 3), 1
    bus.segment.take(frame(0x601, bytes(8)), 1.0)
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (14, 2)
    assert bus.boards.taken() == [("take", ([0x601], 1.0)), ("refuse", [bus.cob_id] * 2)]
