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


def test_a_board_that_makes_its_sums_in_hardware() -> None:
    report = board(taxels={"frontend": "analogue"}).check()
    assert (report.differences, report.notes) == ([], [])


def test_a_test_pattern_that_was_on_is_noted_and_on_again() -> None:
    bench = board()
    bench.wires[0].put(0x601, bytes((0x2F, 0x21, 0x20, 0, PATTERN_FULL, 0, 0, 0)))
    report = bench.check()
    assert not report.differences
    assert ["2021h:0" in note for note in report.notes] == [True]
    assert pattern_of(bench) == PATTERN_FULL


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"device": {"vendor_id": 7}}, ["1018h:1 (Identity, Vendor-ID) is 7h, expected 0h"]),
        ({"encoding": {"offset_binary": True}}, ["2005h:0", "test pattern zero, SYNC 1: TPDO 1 (181h) is 01 55 55"]),
    ],
)
def test_a_board_for_another_layout(tables: dict[str, Any], words: list[str]) -> None:
    report = Checked(small_contract(), built=small_contract(**tables)).check()
    said = "\n".join(report.differences)
    for word in words:
        assert word in said


def test_a_serial_number_of_the_maker_is_a_note() -> None:
    report = Checked(small_contract(), built=small_contract(device={"first_serial": 1000})).check()
    assert not report.differences
    assert "1018h:4" in report.notes[0]


def first_byte(each: np.void) -> None:
    each["data"][0] ^= 1


def under_another_identifier(each: np.void) -> None:
    each["can_id"] = 0x181


@pytest.mark.parametrize(
    ("can_id", "spoil", "said"),
    [
        (0x281, lambda _each: True, "test pattern zero, SYNC 1: TPDO 2 (281h) came 0 times, expected 1"),
        (0x281, under_another_identifier, "test pattern zero, SYNC 1: TPDO 1 (181h) came 2 times, expected 1"),
        (0x181, first_byte, "TPDO 1 (181h) is"),
        (0x080, lambda _each: True, "test pattern zero, SYNC 1: the SYNC was not sent, and so in 3 more of 4 cycles"),
    ],
)
def test_lost_and_wrong_frames(can_id: int, spoil: Callable[[np.void], bool], said: str) -> None:
    assert said in "\n".join(board().spoils(can_id, spoil).check().differences)


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


def answered(change: Callable[[np.ndarray], object], index: int) -> NodeReport:
    """Check a board whose answer about an object is another."""

    def spoil(each: np.void) -> None:
        if each["data"][1:3].tobytes() == index.to_bytes(2, "little"):
            change(each["data"])

    return board().spoils(0x581, spoil).check()


def aborts(data: np.ndarray) -> None:
    """Say that the object does not exist."""
    data[0], data[4:8] = 0x80, (0x00, 0x00, 0x02, 0x06)


def test_a_wrong_signature_differs() -> None:
    report = answered(lambda data: data.__setitem__(4, data[4] ^ 1), 0x2006)
    (said,) = report.differences
    found, expected = (int(each, 16) for each in re.findall(r"([0-9A-F]{8})h", said))
    assert found == expected ^ 1
    assert said.startswith("the signature (2006h) is ")
    assert report.cycles == 16


@pytest.mark.parametrize("change", [aborts, lambda data: data.__setitem__(slice(4, 8), 0)])
def test_a_board_without_signature_is_noted(change: Callable[[np.ndarray], object]) -> None:
    report = answered(change, 0x2006)
    assert report.differences == []
    assert report.notes == ["no signature (2006h): a proof reads every object"]


def test_a_board_that_tells_no_size_of_its_objects_keeps_the_contract() -> None:
    """An expedited answer without size has four bytes (CiA 301, 7.2.4.3.6), those behind the value are 0."""

    def without_size(each: np.void) -> None:
        if each["data"][0] & 0xF3 == 0x43:
            each["data"][0] = 0x42

    bench = board().spoils(0x581, without_size)
    bench.node.local.set_data(od.TEST_PATTERN, 0, b"\1")
    assert bench.check().differences == []
    assert pattern_of(bench) == 1


def test_a_test_pattern_longer_than_its_type_differs() -> None:
    def in_segments(data: np.ndarray) -> None:
        if data[0] == 0x4F:
            data[:8] = (0x41, 0x21, 0x20, 0, 7, 0, 0, 0)
        elif data[0] == 0x80:
            data[:8] = (0x01, 1, 0, 0, 0, 0, 0, 9)

    assert any("2021h:0 (Test pattern) is 9" in each for each in answered(in_segments, 0x2021).notes)


def test_an_object_that_the_board_lacks_differs_and_the_others_are_read() -> None:
    whole, report = board().check(), answered(aborts, 0x1017)
    assert len(report.differences) == 1
    assert "1017h:0" in report.differences[0]
    assert (report.objects, report.cycles) == (whole.objects - 1, 16)


def test_frames_of_other_kinds_are_not_those_of_the_board() -> None:
    bench = board()
    strange = [
        frame(can_id, bytes(8), flags) for can_id in (0x080, 0x181, 0x581) for flags in (ERROR, EXTENDED, REMOTE)
    ]
    report = bench.check(lambda: bench.wires[0].queue.extend((None, each) for each in strange))
    assert (report.differences, report.frames) == ([], 32)


def test_a_test_pattern_that_is_not_taken_differs_and_the_next_is_tried() -> None:
    report = answered(lambda data: aborts(data) if data[0] == 0x60 else None, 0x2021)
    # Three patterns, and the one that was there.
    assert sum(said.startswith("object 2021h:0: abort ") for said in report.differences) == 4
    assert report.cycles == 4  # of offsets in place of the taxels


def test_a_check_that_has_asked_nothing_leaves_nothing_to_undo() -> None:
    contract, sent = small_contract(), list[tuple[int, bytes]]()

    def send(burst: Frames) -> int:
        sent.extend((int(each["can_id"]), each["data"][: each["length"]].tobytes()) for each in burst)
        return len(burst)

    NodeCheck(contract, contract.nodes[1], send, 10.0).give_up(10.0)
    assert sent == [(0, b"\x80\2")]


def with_other_sums(alter: Callable[[np.ndarray], object]) -> Checked:
    """Return a skin whose boards send other sums than those that they have measured."""
    bench = board()
    sample = bench.hardware.sample

    def altered(counter: int, time_ns: int, bus: int = 0) -> np.ndarray:
        sums = sample(counter, time_ns, bus).copy()
        alter(sums)
        return sums

    bench.hardware.sample = altered
    return bench


@pytest.mark.parametrize("one", range(8))
def test_a_sum_of_wrong_sign_is_named_whatever_its_row(one: int) -> None:
    """The test patterns show 0 in most rows."""
    report = with_other_sums(lambda sums: sums.__setitem__(one, -sums[one])).check()
    assert f"{OFFSETS}, SYNC 1: TPDO {1 + one // 4} " in "\n".join(report.differences)


@pytest.mark.parametrize(("one", "other"), [(1, 2), (3, 7), (4, 5)])
def test_exchanged_rows_are_named(one: int, other: int) -> None:
    report = with_other_sums(lambda sums: sums.__setitem__([one, other], sums[[other, one]])).check()
    assert f"{OFFSETS}, SYNC 1: TPDO " in "\n".join(report.differences)


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


def frozen(bench: Checked) -> None:
    """A board that computes 2009h once."""
    kept = bench.node.objects.readers[od.CALIBRATION_SIGNATURE](0)
    bench.node.objects.readers[od.CALIBRATION_SIGNATURE] = lambda _: kept


def without_offsets(bench: Checked) -> None:
    """A board whose 2009h does not cover offsets."""
    covered = bench.node.objects._signed[od.CALIBRATION_SIGNATURE]
    bench.node.objects._signed[od.CALIBRATION_SIGNATURE] = [each for each in covered if each.index != od.OFFSET]


@pytest.mark.parametrize(
    ("spoil", "words"), [(frozen, "of its objects, with other gains and offsets"), (without_offsets, "of its objects")]
)
def test_a_wrong_signature_of_gains_and_offsets_is_named(spoil: Callable[[Checked], None], words: str) -> None:
    bench = board()
    spoil(bench)
    said = bench.check().differences
    assert all(each.startswith("the signature (2009h) is ") for each in said)
    assert any(each.endswith(words) for each in said)


def test_a_board_without_gains_is_noted() -> None:
    report = answered(aborts, od.GAIN)
    assert report.differences == []
    assert report.notes == [
        "object 2010h:1: abort 06020000h, no object: not every row is compared without gains and offsets"
    ]
    assert report.cycles == 12
