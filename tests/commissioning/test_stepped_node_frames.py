"""`skin node check` compares the frames of stepped boards: right boards pass, and each mutant is named."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from commissioning.node_check import NodeCheck
from commissioning.node_frames import NodeReport
from dbc import indices as od
from dbc.contract import Contract
from dbc.steps import SET, STEP, kind_of, read_word
from nodes.firmware.library import Firmware
from nodes.segment import Boards
from nodes.steps.boards import SteppedBoards
from nodes.steps.firmware import FirmwarePatches
from nodes.virtual_boards import VirtualBoards
from skin.layout import changed
from skin.sources import Frame
from tests.commissioning.wrong_signatures import computed_once, without_offsets
from tests.nodes.firmware.stepped_twins import contract_of
from tests.nodes.firmware.twins import needs_compiler
from tests.world import Skin

#: Longer than a check takes.
LONGEST_S = 12.0


class Untouched:
    """Nothing touches the skin; taxels have an offset."""

    has_noise = False

    def __init__(self, contract: Contract, offset_n: float = 0.0) -> None:
        shape = contract.layout.taxels.rows, contract.layout.taxels.columns
        self._offset_n = np.random.default_rng(3).uniform(0, offset_n, shape).astype(np.float32)

    def frame(self, step: int) -> Frame:
        return Frame(self._offset_n, "")


class Checked(Skin):
    """A skin of stepped boards, and who checks node 1 of bus0."""

    step_s = 1e-3
    buses = 1

    def __init__(self, contract: Contract, *, in_c: bool = False, noise_n: float = 0.0, offset_n: float = 0.0) -> None:
        self._in_c, self._noise_n, self._source = in_c, noise_n, Untouched(contract, offset_n)
        super().__init__(contract)

    def new_hardware(self) -> Any:
        if not self._in_c:
            return SteppedBoards(self.contract, [0], self._source, noise_n=self._noise_n)
        mine = self.contract.on_bus(0)[:3]  # as `SteppedTwins`: one library is compiled for both
        self.firmware = Firmware(self.contract, mine)
        blocks = [node.block for node in mine]
        return FirmwarePatches(self.contract, blocks, self._source, self.firmware, noise_n=self._noise_n)

    def new_boards(self, bus: int, contract: Contract) -> Boards:
        if self._in_c:
            return self.firmware.boards(bus)
        return VirtualBoards(contract, bus, {1}, self.hardware)

    def check(self) -> NodeReport:
        check = NodeCheck(self.contract, self.contract.nodes[0], self.wires[0].gateway.send, self.now_s)
        self.lead(check, lambda _bus, arrived: check.take(arrived, self.now_s), at_most_s=LONGEST_S)
        return check.report


@pytest.mark.parametrize(("noise_n", "offset_n"), [(0.0, 0.0), (1e-3, 3e-3)])
@pytest.mark.parametrize("name", ["steps", "steps-fd", "8", "16", "64", "64-fd"])
@pytest.mark.parametrize("in_c", [False, pytest.param(True, marks=needs_compiler)])
def test_a_right_board_keeps_the_contract(name: str, noise_n: float, offset_n: float, *, in_c: bool) -> None:
    bench = Checked(contract_of(name), in_c=in_c, noise_n=noise_n, offset_n=offset_n)
    report = bench.check()
    assert (report.differences, report.notes) == ([], [])
    assert report.frames > 6


@pytest.mark.parametrize("noise_n", [0.0, 1e-3, 3e-3])
@pytest.mark.parametrize("in_c", [False, pytest.param(True, marks=needs_compiler)])
def test_a_right_board_keeps_the_contract_in_every_check_and_then_feels_nothing(noise_n: float, *, in_c: bool) -> None:
    bench = Checked(contract_of("steps"), in_c=in_c, noise_n=noise_n)
    for _ in range(3):
        assert bench.check().differences == []
        for _ in range(300):
            bench.now_s += bench.step_s
            bench.segments[0].tick(bench.now_s)
        assert in_c or not bench.hardware.sums.any()  # boards in C tell theirs in the next check


def tells(alter: Callable[[Any], object]) -> Callable[[Checked], None]:
    """A board whose sums are altered, shape (boards, sums)."""

    def spoil(bench: Checked) -> None:
        take = bench.hardware.filter.take

        def taken(sample_n: Any) -> None:
            take(sample_n)
            alter(bench.hardware.filter.sums_n)

        bench.hardware.filter.take = taken

    return spoil


def exchanged(one: slice, other: slice) -> Callable[[Checked], None]:
    def alter(sums_n: Any) -> None:
        sums_n[:, one], sums_n[:, other] = sums_n[:, other].copy(), sums_n[:, one].copy()

    return tells(alter)


SWAPPED_ROWS, SWAPPED_GROUPS = exchanged(slice(9, 10), slice(10, 11)), exchanged(slice(16, 24), slice(24, 32))
WRONG_SIGN = tells(lambda sums_n: sums_n[:, 20].__imul__(-1))
OTHER_UNIT = tells(lambda sums_n: sums_n.__imul__(1.03))
QUARTER_SCALE = tells(lambda sums_n: sums_n.__imul__(0.25))


def deaf_rule(bench: Checked) -> None:
    """A board that leaves slots empty that are worth a frame."""
    bench.hardware.senders.slots.quiet[:] *= 1e4


def never_checks(bench: Checked) -> None:
    """A board that does not tell whether its receivers have the same sums."""
    take = bench.hardware.senders.take_slots

    def taken(*given: Any) -> Any:
        bench.hardware.senders.state.keep[:] = 10_000
        return take(*given)

    bench.hardware.senders.take_slots = taken


def infinite_noise(bench: Checked) -> None:
    """A board whose noise is infinite."""
    bench.wires[0].loses = lambda end, each: (
        end is bench.wires[0].gateway
        and each["data"][1:3].tobytes() == od.NODE_NOISE.to_bytes(2, "little")
        and each["data"].__setitem__(slice(4, 8), (0, 0, 0x80, 0x7F))
    )


def ignores(index: int) -> Callable[[Checked], None]:
    """A board that takes the writes of an object, and does not follow."""

    def spoil(bench: Checked) -> None:
        adjust = bench.hardware.adjust

        def adjusted(block: int, at: int, subindex: int, value: float) -> None:
            if at != index:
                adjust(block, at, subindex, value)

        bench.hardware.adjust = adjusted

    return spoil


def sent(spoil: Callable[[np.void, int], object]) -> Callable[[Checked], None]:
    """Alter each frame of sums on its way: called with frame and kind of its word; True loses it."""

    def mutate(bench: Checked) -> None:
        node = bench.contract.nodes[0]

        def loses(end: object, each: np.void) -> bool:
            if end is not bench.wires[0].gateway or each["can_id"] != node.tpdos[0].cob_id:
                return False
            return spoil(each, kind_of(read_word(each["data"][1:8]), node.forms[0])[0]) is True

        bench.wires[0].loses = loses

    return mutate


def add(each: np.void, at: int, much: int) -> None:
    each["data"][at] = (int(each["data"][at]) + much) % 256


def later(each: np.void, _kind: int) -> None:
    each["data"][0] = (int(each["data"][0]) + 9) % 240 + 1


MUTANTS = [
    (SWAPPED_ROWS, "offsets in place of the taxels: tells", " as sum 10, expected "),
    (SWAPPED_GROUPS, " as sum 17, expected ", ""),
    (WRONG_SIGN, " as sum 21, expected ", ""),
    (OTHER_UNIT, "offsets in place of the taxels: tells ", ""),
    (infinite_noise, "full scale: the noise (2035h) is no number of newtons: 00 00 80 7f", ""),
    (deaf_rule, "test pattern zero: tells ", ", expected 0.00 mN"),
    (ignores(od.TEST_PATTERN), "test pattern full scale: half of the taxels read less than half of full scale", ""),
    (ignores(od.GAIN), "offsets in place of the taxels: tells ", ""),
    (ignores(od.OFFSET), "offsets in place of the taxels: tells ", ""),
    (QUARTER_SCALE, "test pattern full scale: half of the taxels read less than half of full scale", ""),
    (without_offsets, "the signature (2009h) is ", ""),
    (computed_once, "of its objects, with other gains and offsets", ""),
    (sent(later), "full scale: TPDO 1 (181h) names slot ", ", expected "),
    (sent(lambda each, _: each.__setitem__("length", 7)), "TPDO 1 (181h) has 7 bytes, expected 8", ""),
    (sent(lambda each, _: each["data"].__setitem__(0, 0)), "begins with 0, expected a slot from 1 to 240", ""),
    (sent(lambda each, _: each["data"].__setitem__(slice(1, 8), 255)), "has words that are no step, set or check", ""),
    (sent(lambda _each, _kind: True), "full scale: TPDO 1 (181h): no set of group 1 came after the NMT start", ""),
    (
        sent(lambda each, kind: kind == SET and bool(each["data"][0] % 4 == 0)),
        "has another count than the word before",
        "",
    ),
    (never_checks, "zero: TPDO 1 (181h): no check came within 24 slots after the newest step or set", ""),
    (sent(lambda each, kind: kind == STEP and add(each, 1, 1)), "zero: TPDO 1 (181h) checks other sums than ", ""),
]


@pytest.mark.parametrize(("spoil", "words", "more"), MUTANTS, ids=range(len(MUTANTS)))
def test_a_wrong_board_is_named(spoil: Callable[[Checked], None], words: str, more: str) -> None:
    bench = Checked(contract_of("steps"), noise_n=1e-3 if spoil is deaf_rule else 0.0, offset_n=2e-3)
    spoil(bench)
    said = "\n".join(bench.check().differences)
    for each in (*words.split("{}"), more):
        assert each in said, said


@pytest.mark.parametrize("spoil", [SWAPPED_ROWS, SWAPPED_GROUPS, WRONG_SIGN, OTHER_UNIT])
def test_a_wrong_board_on_can_fd_is_named(spoil: Callable[[Checked], None]) -> None:
    bench = Checked(contract_of("steps-fd"))
    spoil(bench)
    assert any(" mN as sum " in each for each in bench.check().differences)


def test_another_rule_of_sending_is_noted() -> None:
    bench = Checked(contract_of("8"))
    for subindex, value in ((1, 0x3E800000), (3, 200)):  # 0.25; 200 us
        bench.wires[0].put(0x601, struct.pack("<BHBI", 0x23, od.SENDING, subindex, value))
    report = bench.check()
    assert report.differences == []
    assert [each.split(" ", 1)[0] for each in report.notes] == ["2031h:1", "2031h:3"]


def test_boards_that_send_at_sync_are_checked() -> None:
    layout = changed(contract_of("8").layout, sync={"rate_hz": 200.0}, steps={"slot_s": 0.005, "at_sync": True})
    report = Checked(Contract.from_layout(layout)).check()
    assert report.differences == []
    assert report.frames > 6
