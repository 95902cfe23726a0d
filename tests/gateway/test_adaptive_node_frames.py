"""`skin node check` compares the frames of adaptive boards: right boards pass, and each mutant is named."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dbc import indices as od
from dbc.contract import Contract
from gateway.node_check import NodeCheck
from gateway.node_frames import NodeReport
from nodes.adaptive.boards import AdaptiveBoards
from nodes.adaptive.firmware import FirmwarePatches
from nodes.firmware.library import Firmware
from nodes.segment import Segment
from nodes.virtual_boards import VirtualBoards
from skin.sources import Frame
from tests.gateway.helpers import Wire
from tests.nodes.firmware.adaptive_twins import contract_of
from tests.nodes.firmware.twins import needs_compiler

STEP_S = 0.001
#: Longer than a check takes.
LONGEST_S = 6.0


class Untouched:
    """Nothing touches the skin; taxels have an offset."""

    has_noise = False

    def __init__(self, contract: Contract, offset_n: float = 0.0) -> None:
        shape = contract.layout.taxels.rows, contract.layout.taxels.columns
        self._offset_n = np.random.default_rng(3).uniform(0, offset_n, shape).astype(np.float32)

    def frame(self, step: int) -> Frame:
        return Frame(self._offset_n, "")


class Bench:
    """Node 1 of bus0, and the check."""

    def __init__(self, contract: Contract, *, in_c: bool = False, noise_n: float = 0.0, offset_n: float = 0.0) -> None:
        self.contract, self.now_s, self.wire = contract, 10.0, Wire()
        source = Untouched(contract, offset_n)
        self.hardware: Any
        boards: Any
        if in_c:
            mine = contract.on_bus(0)[:3]  # as `AdaptiveTwins`: one library is compiled for both
            firmware = Firmware(contract, mine)
            blocks = [node.block for node in mine]
            self.hardware = FirmwarePatches(contract, blocks, source, firmware, noise_n=noise_n)
            boards = firmware.boards(0)
        else:
            self.hardware = AdaptiveBoards(contract, [0], source, noise_n=noise_n)
            boards = VirtualBoards(contract, 0, {1}, self.hardware)
        send = self.wire.nodes.send
        self.boards = boards
        self.segment = Segment(contract, 0, boards, self.hardware, send, complain=lambda _text: None)
        self.segment.boot(self.now_s)

    def check(self) -> NodeReport:
        check = NodeCheck(self.contract, self.contract.nodes[0], self.wire.gateway.send, self.now_s)
        end_s = self.now_s + LONGEST_S
        while not check.done:
            self.now_s += STEP_S
            assert self.now_s < end_s
            self.wire.now_ns = round(self.now_s * 1e9)
            check.tick(self.now_s)
            self.segment.tick(self.now_s)
            while self.wire.deliver() or self.wire.gateway.has_news:
                self.segment.take(self.wire.nodes.receive(), self.now_s)
                check.take(self.wire.gateway.receive(), self.now_s)
        return check.report


@pytest.mark.parametrize(("noise_n", "offset_n"), [(0.0, 0.0), (1e-3, 3e-3)])
@pytest.mark.parametrize("name", ["adaptive", "adaptive-fd", "8", "16", "64", "16-fd", "64-fd"])
@pytest.mark.parametrize("in_c", [False, pytest.param(True, marks=needs_compiler)])
def test_a_right_board_keeps_the_contract(name: str, noise_n: float, offset_n: float, *, in_c: bool) -> None:
    bench = Bench(contract_of(name), in_c=in_c, noise_n=noise_n, offset_n=offset_n)
    report = bench.check()
    assert (report.differences, report.notes) == ([], [])
    assert report.frames > 6


def swapped_rows(bench: Bench) -> None:
    order = bench.hardware.filter._order = bench.hardware.filter._order.copy()
    order[[9, 10]] = order[[10, 9]]


def swapped_groups(bench: Bench) -> None:
    order = bench.hardware.filter._order = bench.hardware.filter._order.copy()
    order[16:24], order[24:] = order[24:].copy(), order[16:24].copy()


def wrong_sign(bench: Bench) -> None:
    take = bench.hardware.filter.take

    def taken(sample_n: Any) -> None:
        take(sample_n)
        bench.hardware.filter.sums_n[:, 20] *= -1

    bench.hardware.filter.take = taken


def swapped_identifiers(bench: Bench) -> None:
    cob_ids = bench.hardware.controllers.cob_id[0].tolist()
    # Coarse frames of level 0: groups 0 and 1.
    cob_ids[20], cob_ids[21] = cob_ids[21], cob_ids[20]
    bench.hardware.set_tpdos(0, cob_ids, bench.hardware.controllers.inhibit[0].tolist())


def other_code(bench: Bench) -> None:
    """A board whose codes are those of another full scale."""
    bench.hardware._law = bench.hardware._law._replace(knee_n=1.03 * bench.contract.law.knee_n)


def deaf_rule(bench: Bench) -> None:
    """A board that finds news thirty times too late."""
    bench.hardware.controllers.rule["noise_ratio"] *= 30


def infinite_noise(bench: Bench) -> None:
    """A board whose noise is infinite."""
    bench.wire.loses = lambda end, each: (
        end is bench.wire.gateway
        and each["data"][1:3].tobytes() == od.NODE_NOISE.to_bytes(2, "little")
        and each["data"].__setitem__(slice(4, 8), (0, 0, 0x80, 0x7F))
    )


def ignores(index: int) -> Callable[[Bench], None]:
    """A board that takes the writes of an object, and does not follow."""

    def spoil(bench: Bench) -> None:
        adjust = bench.hardware.adjust

        def adjusted(block: int, at: int, subindex: int, value: float) -> None:
            if at != index:
                adjust(block, at, subindex, value)

        bench.hardware.adjust = adjusted

    return spoil


def half_scale(bench: Bench) -> None:
    sample = bench.hardware._sensors.sample

    def sampled(tick_ns: int) -> Any:
        return sample(tick_ns) / 4

    bench.hardware._sensors.sample = sampled


def unsigned_gains(bench: Bench) -> None:
    """A board whose 2009h does not cover the offsets."""
    node = bench.boards.nodes[0]
    node._signed[od.CALIBRATION_SIGNATURE] = [
        each for each in node._signed[od.CALIBRATION_SIGNATURE] if each.index != od.OFFSET
    ]


def stale_signature(bench: Bench) -> None:
    """A board that computes 2009h once."""
    node = bench.boards.nodes[0]
    read, kept = node._live[od.CALIBRATION_SIGNATURE], list[int]()
    node._live[od.CALIBRATION_SIGNATURE] = lambda subindex: kept[0] if kept else kept.append(read(subindex)) or kept[0]


def sent(spoil: Callable[[np.void, int, int, bool], object]) -> Callable[[Bench], None]:
    """Alter each frame of sums on its way: called with frame, level, group and whether it is fine; True loses it."""

    def mutate(bench: Bench) -> None:
        tpdos = {each.cob_id: each for each in bench.contract.nodes[0].adaptive_tpdos}

        def loses(end: object, each: np.void) -> bool:
            tpdo = tpdos.get(int(each["can_id"]))
            if end is not bench.wire.gateway or tpdo is None:
                return False
            return spoil(each, tpdo.level, tpdo.group, tpdo.is_fine) is True

        bench.wire.loses = loses

    return mutate


def add(each: np.void, at: int, much: int) -> None:
    each["data"][at] = (int(each["data"][at]) + much) % 256


def highest(each: np.void, level: int, group: int, is_fine: bool) -> None:
    if not is_fine:
        each["can_id"] -= 128 * (5 - level)


MUTANTS = [
    (swapped_rows, "offsets in place of the taxels: TPDO {} tells", " as sum 10, expected "),
    (swapped_groups, " as sum 17, expected ", ""),
    (wrong_sign, " as sum 21, expected ", ""),
    (swapped_identifiers, "full scale: TPDO 5 (201h) tells 640.00 mN as sum 1, expected ", ""),
    (other_code, "offsets in place of the taxels: TPDO ", ""),
    (infinite_noise, "full scale: the noise (2035h) is no number of newtons: 00 00 80 7f", ""),
    (deaf_rule, "test pattern zero: no coarse frame of group 1 came as news of the step", ""),
    (ignores(od.TEST_PATTERN), "test pattern full scale: half of the taxels read less than half of full scale", ""),
    (ignores(od.GAIN), "offsets in place of the taxels: TPDO ", ""),
    (ignores(od.OFFSET), "offsets in place of the taxels: TPDO ", ""),
    (half_scale, "test pattern full scale: half of the taxels read less than half of full scale", ""),
    (unsigned_gains, "the signature (2009h) is ", ""),
    (stale_signature, "of its objects, with other gains and offsets", ""),
    (sent(highest), " has level 5 without news, expected 0", ""),
    (sent(lambda each, _level, _group, fine: fine and add(each, 7, 1)), " has another check than that of ", ""),
    (sent(lambda _each, _level, _group, fine: fine), "full scale: no fine frame of group 1 came", ""),
    (sent(lambda _each, _level, group, fine: group == 3 and not fine), "no coarse frame of group 3 came after", ""),
    (sent(lambda each, _level, group, fine: not fine and group == 2 and add(each, 5, 1)), " as sum 22, expected", ""),
    (sent(lambda each, *_: each.__setitem__("length", 7)), " has 7 bytes, expected 8", ""),
]


@pytest.mark.parametrize(("spoil", "words", "more"), MUTANTS, ids=range(len(MUTANTS)))
def test_a_wrong_board_is_named(spoil: Callable[[Bench], None], words: str, more: str) -> None:
    bench = Bench(contract_of("adaptive"), noise_n=1e-3 if spoil is deaf_rule else 0.0, offset_n=2e-3)
    spoil(bench)
    said = "\n".join(bench.check().differences)
    for each in (*words.split("{}"), more):
        assert each in said, said


@pytest.mark.parametrize("spoil", [swapped_rows, swapped_groups, wrong_sign, other_code])
def test_a_wrong_board_on_can_fd_is_named(spoil: Callable[[Bench], None]) -> None:
    bench = Bench(contract_of("adaptive-fd"))
    spoil(bench)
    assert any(" mN as sum " in each for each in bench.check().differences)


def test_another_rule_of_sending_is_noted() -> None:
    bench = Bench(contract_of("8"))
    for index, subindex, value in ((od.SENDING, 6, 2), (od.BUDGET, 0, 9000)):
        bench.wire.put(0x601, struct.pack("<BHBI", 0x23, index, subindex, value))
    report = bench.check()
    assert report.differences == []
    assert [each.split(" ", 1)[0] for each in report.notes] == ["2031h:6", "2034h:0"]
