"""`skin node check` finds what differs, and leaves the board as it was."""

import itertools
import re
import struct
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from commissioning.node_check import NodeCheck
from commissioning.node_frames import NodeReport
from dbc import indices as od
from dbc.board_sums import PATTERN_FULL
from dbc.canopen import Emergency, NmtCommand, NmtState
from dbc.contract import Contract
from dbc.frame import ERROR, EXTENDED, REMOTE, Frames
from nodes.firmware.library import Firmware
from nodes.hardware import Hardware
from nodes.node import SkinNode
from nodes.segment import Boards
from nodes.sending import sending_of
from tests.bus.harness import frame
from tests.commissioning.wrong_signatures import computed_once, without_offsets
from tests.layouts import buses, small_contract
from tests.nodes.firmware.twins import needs_compiler
from tests.world import Shaking, Skin

STEP_S = 0.005
#: 1007h at 20 SYNCs a second: 99 % of the period.
WINDOW_US = 49_500
#: What a board shows after the test patterns.
OFFSETS = "offsets in place of the taxels"


#: Sums in turns.
TURNS = {"rate_hz": 20.0, "turns": 2}


class Checked(Skin):
    """A skin, and who checks its first board."""

    step_s = STEP_S
    buses = 1

    @property
    def node(self) -> SkinNode:
        """The board that is checked, if it is in Python."""
        node: SkinNode = self.segments[0].boards.nodes[0]
        return node

    def check(self, each_step: Callable[[], object] = lambda: None) -> NodeReport:
        """Check node 1 to the end."""
        check = NodeCheck(self.contract, self.contract.nodes[0], self.wires[0].gateway.send, self.now_s)
        self.lead(check, lambda _bus, arrived: check.take(arrived, self.now_s), each_step)
        return check.report

    def spoils(self, can_id: int, change: Callable[[np.void], object]) -> "Checked":
        """Let the check hear other frames with one identifier than are sent: `change` alters each; True loses it."""
        wire = self.wires[0]
        wire.loses = lambda end, each: end is wire.gateway and each["can_id"] == can_id and change(each) is True
        return self


class CheckedInC(Checked):
    """The same with node 1 in C."""

    def new_hardware(self) -> Hardware:
        self.firmware = Firmware(self.contract, self.contract.nodes[:1])
        return sending_of(self.contract.layout).hardware(self.contract, [0], Shaking((8, 16)), self.firmware)

    def new_boards(self, bus: int, contract: Contract) -> Boards:
        return self.firmware.boards(bus)


def board(**tables: Any) -> Checked:
    return Checked(small_contract(**tables))


@needs_compiler
@pytest.mark.parametrize(
    ("tables", "cycles"),
    [
        ({}, 16),
        ({"bus": buses(2, 2, fd=True), "sync": TURNS}, 16),
        ({"taxels": {"frontend": "analogue"}}, 12),
    ],
)
def test_boards_in_c_keep_the_contract(tables: dict[str, Any], cycles: int) -> None:
    report = CheckedInC(small_contract(**tables)).check()
    assert (report.differences, report.notes, report.cycles) == ([], [], cycles)


def pattern_of(bench: Checked) -> int:
    return int(bench.node.local.get_data(od.TEST_PATTERN, 0)[0])


@pytest.mark.parametrize("sync", [{"rate_hz": 20.0}, TURNS])
@pytest.mark.parametrize("bus", [buses(2, 2), buses(1, 1, blocks_per_node=2), buses(2, 2, fd=True)])
def test_a_board_that_keeps_the_contract(bus: list[dict[str, Any]], sync: dict[str, Any]) -> None:
    bench = board(bus=bus, sync=sync)
    report = bench.check()
    node = bench.contract.nodes[0]
    assert (report.bus, report.node_id, report.differences, report.notes) == ("bus0", 1, [], [])
    assert (report.cycles, report.frames) == (16, 16 * len(node.tpdos) // sync.get("turns", 1))
    assert report.objects > len(node.tpdos) * 3
    assert 0 < report.latest_s < bench.contract.layout.sync.period_s
    assert (bench.node.state, pattern_of(bench)) == (NmtState.PRE_OPERATIONAL, 0)
    # Patterns are written while the board is PRE-OPERATIONAL, as its writer may expect.
    commands = [data[0] for can_id, data in bench.wires[0].log if can_id == 0]
    before_start = [first for first, second in itertools.pairwise(commands) if second == NmtCommand.START]
    assert before_start == [NmtCommand.ENTER_PRE_OPERATIONAL] * 4


@pytest.mark.parametrize(("pause_s", "cycles"), [(0.0, 16), (0.3, 20)])
@pytest.mark.parametrize("sync", [{"rate_hz": 20.0}, TURNS])
def test_a_board_that_leaves_operational_for_a_pause_of_sync_keeps_the_contract(
    sync: dict[str, Any], pause_s: float, cycles: int
) -> None:
    """So does CANopenNode after 1.5 periods. A pattern that fell into a pause of the computer is shown again."""
    bench = board(sync=sync)
    synced_s, pauses_s = np.inf, [pause_s]

    def hears(end: object, each: np.void) -> bool:
        nonlocal synced_s
        if end is bench.wires[0].nodes and each["can_id"] == 0x080:
            synced_s = bench.now_s
        return False

    def leaves() -> None:
        if pauses_s and bench.node.state == NmtState.OPERATIONAL and synced_s < np.inf:
            bench.now_s += pauses_s.pop()
        if bench.now_s - synced_s > 0.075:
            bench.node.state = NmtState.PRE_OPERATIONAL

    bench.wires[0].loses = hears
    report = bench.check(leaves)
    assert (report.differences, report.cycles) == ([], cycles)
    assert not pauses_s


def test_a_board_that_does_not_stay_operational_differs_once_for_each_pattern_and_says_why() -> None:
    bench = board()
    bench.node.emcy.raised(Emergency.SYNC_LENGTH)

    def leaves() -> None:
        bench.node.state = NmtState.PRE_OPERATIONAL

    report = bench.check(leaves)
    why = "its error register (1001h) is 11h, its newest error (1003h:1) 8240h"
    assert report.notes == [why]
    assert report.differences == [
        f"{name}: the board left OPERATIONAL for pre-operational; {why}"
        for name in (*(f"test pattern {each}" for each in ("zero", "ramp", "full scale")), OFFSETS)
    ]


Spoil = Callable[[Checked], object]


def hears(can_id: int, change: Callable[[np.void], object]) -> Spoil:
    return lambda bench: bench.spoils(can_id, change)


def answers(index: int, change: Callable[[np.ndarray], object]) -> Spoil:
    """The board's answer about an object is another."""

    def spoil(each: np.void) -> None:
        if each["data"][1:3].tobytes() == index.to_bytes(2, "little"):
            change(each["data"])

    return hears(0x581, spoil)


def aborts(data: np.ndarray) -> None:
    """Say that the object does not exist."""
    data[0], data[4:8] = 0x80, (0x00, 0x00, 0x02, 0x06)


def refuses(data: np.ndarray) -> None:
    """Refuse a write."""
    if data[0] == 0x60:
        aborts(data)


def without_size(data: np.ndarray) -> None:
    """Tell no size of a value (CiA 301, 7.2.4.3.6): it has four bytes, those behind the value are 0."""
    if data[0] & 0xF3 == 0x43:
        data[0] = 0x42


def of_seven_bytes(data: np.ndarray) -> None:
    """Tell a test pattern of more bytes than its type has."""
    if data[0] == 0x4F:
        data[:8] = (0x41, 0x21, 0x20, 0, 7, 0, 0, 0)
    elif data[0] == 0x80:
        data[:8] = (0x01, 1, 0, 0, 0, 0, 0, 9)


def sums(alter: Callable[[np.ndarray], object]) -> Spoil:
    """Boards send other sums than those that they have measured."""

    def spoil(bench: Checked) -> None:
        sample = bench.hardware.sample

        def altered(counter: int, time_ns: int, bus: int = 0) -> np.ndarray:
            made = sample(counter, time_ns, bus).copy()
            alter(made)
            return made

        bench.hardware.sample = altered

    return spoil


def shows(pattern: int) -> Spoil:
    return lambda bench: bench.node.local.set_data(od.TEST_PATTERN, 0, bytes((pattern,)))


def exchanged(one: int, other: int) -> Spoil:
    return sums(lambda made: made.__setitem__([one, other], made[[other, one]]))


#: A board for another layout, or what it does: words in its differences, words in its notes, and cycles.
SPOILT: dict[str, tuple[dict[str, Any] | Spoil, list[str], list[str], int]] = {
    "another maker": ({"device": {"vendor_id": 7}}, ["1018h:1 (Identity, Vendor-ID) is 7h, expected 0h"], [], 16),
    "another encoding": (
        {"encoding": {"offset_binary": True}},
        ["2005h:0", "test pattern zero, SYNC 1: TPDO 1 (181h) is 01 55 55"],
        [],
        16,
    ),
    "numbers of the maker": ({"device": {"first_serial": 1000}}, [], ["1018h:4"], 16),
    "a test pattern was on": (shows(PATTERN_FULL), [], ["2021h:0"], 16),
    "a frame is lost": (
        hears(0x281, lambda _: True),
        ["test pattern zero, SYNC 1: TPDO 2 (281h) came 0 times, expected 1"],
        [],
        16,
    ),
    "a frame of another identifier": (
        hears(0x281, lambda each: each.__setitem__("can_id", 0x181)),
        ["test pattern zero, SYNC 1: TPDO 1 (181h) came 2 times, expected 1"],
        [],
        16,
    ),
    "another counter": (hears(0x181, lambda each: each["data"].__ixor__(1)), ["TPDO 1 (181h) is"], [], 16),
    "no SYNC": (
        hears(0x080, lambda _: True),
        ["test pattern zero, SYNC 1: the SYNC was not sent, and so in 3 more of 4 cycles"],
        [],
        16,
    ),
    "no signature object": (
        answers(od.SIGNATURE, aborts),
        [],
        ["no signature (2006h): a proof reads every object"],
        16,
    ),
    "signature 0": (
        answers(od.SIGNATURE, lambda data: data.__setitem__(slice(4, 8), 0)),
        [],
        ["no signature (2006h): a proof reads every object"],
        16,
    ),
    "signature 2009h computed once": (computed_once, ["signature (2009h) is ", "with other gains and offsets"], [], 16),
    "signature 2009h without offsets": (without_offsets, ["signature (2009h) is ", "of its objects"], [], 16),
    "no size of objects": (hears(0x581, lambda each: without_size(each["data"])), [], [], 16),
    "a pattern of seven bytes": (
        answers(od.TEST_PATTERN, of_seven_bytes),
        ["object 2021h:0: expected 1 byte, got 01 00 00 00 00 00 09"],
        [],
        0,
    ),
    "an object that the board lacks": (answers(od.HEARTBEAT_MS, aborts), ["1017h:0"], [], 16),
    # Three patterns, and the one that was there; then the offsets in place of the taxels.
    "a pattern that is not taken": (answers(od.TEST_PATTERN, refuses), ["object 2021h:0: abort "], [], 4),
    "no gains": (
        answers(od.GAIN, aborts),
        [],
        ["object 2010h:1: abort 06020000h, no object: not every row is compared without gains and offsets"],
        12,
    ),
    # The test patterns show 0 in most rows.
    **{
        f"sum {one} of wrong sign": (
            sums(lambda made, one=one: made.__setitem__(one, -made[one])),  # type: ignore[misc]
            [f"{OFFSETS}, SYNC 1: TPDO {1 + one // 4} "],
            [],
            16,
        )
        for one in range(8)
    },
    **{
        f"sums {one} and {other} exchanged": (exchanged(one, other), [f"{OFFSETS}, SYNC 1: TPDO "], [], 16)
        for one, other in ((1, 2), (3, 7), (4, 5))
    },
}


@pytest.mark.parametrize("what", SPOILT)
def test_a_wrong_board_is_named(what: str) -> None:
    spoil, differences, notes, cycles = SPOILT[what]
    bench = board() if callable(spoil) else Checked(small_contract(), built=small_contract(**spoil))
    if callable(spoil):
        spoil(bench)
    before = pattern_of(bench)
    report = bench.check()
    said = "\n".join(report.differences)
    assert all(each in said for each in differences)
    assert bool(said) == bool(differences), said
    assert [note in each for note, each in zip(notes, report.notes, strict=True)] == [True] * len(notes)
    assert report.cycles == cycles
    assert pattern_of(bench) == before
    if what == "a pattern that is not taken":
        assert said.count("object 2021h:0: abort ") == 4


def test_nobody_there() -> None:
    bench = board()
    bench.wires[0].loses = lambda end, _each: end is bench.wires[0].nodes
    report = bench.check()
    assert len(report.differences) == 1
    assert "no answer to object 1005h:0: is the board on this bus" in report.differences[0]
    assert report.objects == report.frames == 0


def test_a_board_that_leaves_is_asked_once_more_and_not_again() -> None:
    bench = board()
    is_gone = False

    def loses(end: object, each: np.void) -> bool:
        nonlocal is_gone
        is_gone |= end is bench.wires[0].gateway and each["can_id"] == 0x281
        return is_gone and end is bench.wires[0].nodes

    bench.wires[0].loses = loses
    report = bench.check()
    assert report.differences[-1].startswith("no answer to object 2021h:0")
    assert bench.wires[0].log[-1] == (0x000, bytes((NmtCommand.RESET_NODE, 1)))
    assert sum("no answer" in text for text in report.differences) == 1
    assert report.cycles == 4


def test_the_bus_of_a_running_gateway_is_refused() -> None:
    bench = board()
    report = bench.check(lambda: bench.wires[0].put(0x080, b"\x05"))
    assert report.differences == ["another program sends SYNC on this bus: stop the gateway, then check again"]
    assert all(can_id == 0x080 or can_id > 0x700 for can_id, _ in bench.wires[0].log)


def gain_of(bench: Checked) -> float:
    return float(struct.unpack("<f", bench.node.local.get_data(od.GAIN, 32))[0])


@pytest.mark.parametrize(
    "is_time", [lambda bench: pattern_of(bench) == PATTERN_FULL, lambda bench: gain_of(bench) == 0]
)
def test_a_check_that_is_stopped_puts_back_what_it_wrote(is_time: Callable[[Checked], bool]) -> None:
    bench = board()
    check = NodeCheck(bench.contract, bench.contract.nodes[0], bench.wires[0].gateway.send, bench.now_s)

    def hear(_bus: int, arrived: Frames) -> None:
        check.take(arrived, bench.now_s)

    while not is_time(bench):
        bench.now_s += STEP_S
        check.tick(bench.now_s)
        bench.carry(hear)
    bench.wires[0].log.clear()
    check.give_up(bench.now_s)
    bench.carry(hear)
    assert check.done
    assert bench.wires[0].log[0] == (0x000, b"\x80\x01")
    assert (pattern_of(bench), gain_of(bench), bench.node.local.get_data(od.OFFSET, 32)) == (0, 1.0, bytes(2))


@pytest.mark.parametrize(("rate_hz", "listens_s"), [(5.0, 0.6), (20.0, 0.2), (100.0, 0.2)])
def test_the_bus_is_heard_before_anything_is_sent(rate_hz: float, listens_s: float) -> None:
    small = small_contract().layout
    layout = msgspec.structs.replace(small, sync=msgspec.structs.replace(small.sync, rate_hz=rate_hz))
    contract, sent = Contract.from_layout(layout), list[Frames]()

    def send(burst: Frames) -> int:
        sent.append(burst)
        return len(burst)

    check = NodeCheck(contract, contract.nodes[0], send, 0.0)
    check.tick(listens_s - 0.001)
    assert not sent
    check.tick(listens_s + 0.001)
    assert [(int(each["can_id"][0]), each["data"][0, :4].tobytes()) for each in sent] == [(0x601, b"\x40\x05\x10\0")]


def test_frames_that_are_read_late_are_used_when_they_were_in_time() -> None:
    bench, steps = board(), itertools.count()

    def hold() -> None:
        bench.wires[0].gateway.is_held = next(steps) % 20 != 0

    report = bench.check(hold)
    assert (report.differences, report.frames) == ([], 32)
    assert report.latest_s < 0.05


@pytest.mark.parametrize(("after_us", "is_late"), [(WINDOW_US, False), (WINDOW_US + 100, True)])
def test_a_tpdo_after_its_window_differs(after_us: int, *, is_late: bool) -> None:
    def late(each: np.void) -> None:
        each["time_ns"] = bench.wires[0].now_ns + after_us * 1000

    bench = board().spoils(0x281, late)
    report = bench.check()
    said = f"test pattern zero, SYNC 1: TPDO 2 ends {after_us / 1000:.1f} ms after SYNC, after 1007h"
    assert report.differences[:1] == [f"{said}, and so in 3 more of 4 cycles"] * is_late
    assert len(report.differences) == 4 * is_late
    assert report.latest_s == pytest.approx(after_us / 1e6)


def test_a_wrong_signature_differs() -> None:
    bench = board()
    answers(od.SIGNATURE, lambda data: data.__setitem__(4, data[4] ^ 1))(bench)
    (said,) = bench.check().differences
    found, expected = (int(each, 16) for each in re.findall(r"([0-9A-F]{8})h", said))
    assert found == expected ^ 1
    assert said.startswith("the signature (2006h) is ")


def test_frames_of_other_kinds_are_not_those_of_the_board() -> None:
    bench = board()
    strange = [
        frame(can_id, bytes(8), flags) for can_id in (0x080, 0x181, 0x581) for flags in (ERROR, EXTENDED, REMOTE)
    ]
    report = bench.check(lambda: bench.wires[0].queue.extend((None, each) for each in strange))
    assert (report.differences, report.frames) == ([], 32)


def test_a_check_that_has_asked_nothing_leaves_nothing_to_undo() -> None:
    contract, sent = small_contract(), list[tuple[int, bytes]]()

    def send(burst: Frames) -> int:
        sent.extend((int(each["can_id"]), each["data"][: each["length"]].tobytes()) for each in burst)
        return len(burst)

    NodeCheck(contract, contract.nodes[1], send, 10.0).give_up(10.0)
    assert sent == [(0, b"\x80\2")]


def test_gains_and_offsets_are_as_before_and_their_signature_follows_them() -> None:
    bench = board()
    request = struct.pack("<BHB", 0x23, od.GAIN, 1) + struct.pack("<f", 0.75)
    bench.wires[0].put(0x601, request)
    bench.carry(lambda _bus, _arrived: None)

    def signed() -> int:
        return int(bench.node.objects.readers[od.CALIBRATION_SIGNATURE](0) or 0)

    before, seen = signed(), set[int]()
    report = bench.check(lambda: seen.add(signed()))
    assert (report.differences, report.notes) == ([], [])
    assert (signed(), len(seen)) == (before, 5)  # four patterns besides
    assert struct.unpack("<f", bench.node.local.get_data(od.GAIN, 1)) == (0.75,)
    assert bench.node.local.get_data(od.OFFSET, 1) == bytes(2)
