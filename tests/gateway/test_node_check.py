"""`skin node check` finds what differs, and leaves the board as it was."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from dbc.board_sums import PATTERN_FULL
from dbc.canopen import NmtCommand, NmtState
from dbc.contract import Contract
from dbc.indices import OD_TEST_PATTERN
from gateway.node_check import CYCLES, NodeCheck, NodeReport
from nodes.sampler import new_sampler
from nodes.synchronous_segment import SynchronousSegment
from tests.gateway.world import Shaking, Wire, small_contract
from tests.identity import IDENTITIES, with_identity

STEP_S = 0.005


class Bench:
    """One bus with its boards, and nobody else."""

    def __init__(self, contract: Contract, built: Contract | None = None) -> None:
        self.contract, self.now_s = contract, 10.0
        self.wire = Wire()
        sampler = new_sampler(contract.layout, contract.phi, Shaking(), noise_n=0.0)
        ids = {node.node_id for node in contract.on_bus(0)}
        self.segment = SynchronousSegment(
            built or contract, 0, ids, self.wire.nodes.send, sampler, complain=lambda _text: None
        )
        self.segment.boot(self.now_s)
        self.node = self.segment.nodes[0]

    def check(self, each_step: Callable[[], None] = lambda: None) -> NodeReport:
        """Check node 1 to the end."""
        check = NodeCheck(self.contract, self.contract.nodes[0], self.wire.gateway.send, self.now_s)
        while not check.done:
            self.now_s += STEP_S
            assert self.now_s < 60
            each_step()
            check.tick(self.now_s)
            self.segment.tick(self.now_s)
            self.wire.now_ns = round(self.now_s * 1e9)
            while self.wire.deliver():
                self.segment.take(self.wire.nodes.receive(), self.now_s)
                check.take(self.wire.gateway.receive(), self.now_s)
        return check.report


def pattern_of(bench: Bench) -> int:
    return int(bench.node.local.get_data(OD_TEST_PATTERN, 0)[0])


@pytest.mark.parametrize("identity", IDENTITIES)
@pytest.mark.parametrize("bus", ["nodes = 2", "nodes = 1\nblocks_per_node = 2", "nodes = 2\nfd = true"])
def test_a_board_that_keeps_the_contract(bus: str, identity: str) -> None:
    layout = with_identity(small_contract(bus=bus).layout, identity)
    bench = Bench(Contract.from_layout(layout))
    report = bench.check()
    node = bench.contract.nodes[0]
    assert (report.bus, report.node_id, report.differences, report.notes) == ("bus0", 1, [], [])
    due = sum(tpdo.phase == 0 for tpdo in node.tpdos)
    assert (report.cycles, report.frames) == (3 * CYCLES, 3 * CYCLES * due)
    assert report.objects > len(node.tpdos) * 3
    assert 0 < report.latest_s < bench.contract.layout.sync.period_s
    assert (bench.node.state, pattern_of(bench)) == (NmtState.PRE_OPERATIONAL, 0)
    # Patterns are written while the board is PRE-OPERATIONAL, as its writer may expect.
    commands = [data[0] for can_id, data in bench.wire.log if can_id == 0]
    before_start = [first for first, second in itertools.pairwise(commands) if second == NmtCommand.START]
    assert before_start == [NmtCommand.ENTER_PRE_OPERATIONAL] * 3


def test_a_board_that_makes_its_sums_in_hardware() -> None:
    report = Bench(small_contract(taxels='frontend = "analogue"')).check()
    assert (report.differences, report.notes) == ([], [])


def test_a_test_pattern_that_was_on_is_noted_and_on_again() -> None:
    bench = Bench(small_contract())
    bench.wire.put(0x601, bytes((0x2F, 0x21, 0x20, 0, PATTERN_FULL, 0, 0, 0)))
    report = bench.check()
    assert not report.differences
    assert ["2021h:0" in note for note in report.notes] == [True]
    assert pattern_of(bench) == PATTERN_FULL


@pytest.mark.parametrize(
    ("top", "words"),
    [
        ("[device]\nvendor_id = 7", ["1018h:1 (Identity, Vendor-ID) is 7h, expected 0h"]),
        ("[encoding]\noffset_binary = true", ["2005h:0", "test pattern zero, SYNC 1: TPDO 1 (181h) is 55 55"]),
    ],
)
def test_a_board_for_another_layout(top: str, words: list[str]) -> None:
    report = Bench(small_contract(), small_contract(top=top)).check()
    said = "\n".join(report.differences)
    for word in words:
        assert word in said


def test_a_serial_number_of_the_maker_is_a_note() -> None:
    report = Bench(small_contract(), small_contract(top="[device]\nfirst_serial = 1000")).check()
    assert not report.differences
    assert "1018h:4" in report.notes[0]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda _each: False, []),
        (lambda each: each["can_id"] == 0x281, ["SYNC 1: TPDO 2 (281h) came 0 times, expected 1"]),
        (lambda each: each["data"].__setitem__(0, each["data"][0] ^ 1) is not None, ["TPDO 1 (181h) is"]),
    ],
)
def test_lost_and_wrong_frames(spoil: Callable[[np.void], bool], words: list[str]) -> None:
    bench = Bench(small_contract())
    bench.wire.loses = lambda end, each: end is bench.wire.gateway and each["can_id"] in {0x181, 0x281} and spoil(each)
    report = bench.check()
    assert bool(report.differences) == bool(words)
    assert all(word in "\n".join(report.differences) for word in words)


def test_nobody_there() -> None:
    bench = Bench(small_contract())
    bench.wire.loses = lambda end, _each: end is bench.wire.nodes
    report = bench.check()
    assert len(report.differences) == 1
    assert "no answer to object 1005h:0: is the board on this bus" in report.differences[0]
    assert report.objects == report.frames == 0


def test_a_board_that_leaves_is_asked_once_more_and_not_again() -> None:
    bench = Bench(small_contract())
    is_gone = False

    def loses(end: object, each: np.void) -> bool:
        nonlocal is_gone
        is_gone |= end is bench.wire.gateway and each["can_id"] == 0x281
        return is_gone and end is bench.wire.nodes

    bench.wire.loses = loses
    report = bench.check()
    assert report.differences[-1].startswith("no answer to object 2021h:0")
    assert sum("no answer" in text for text in report.differences) == 1
    assert report.cycles == CYCLES


def test_the_bus_of_a_running_gateway_is_refused() -> None:
    bench = Bench(small_contract())
    report = bench.check(lambda: bench.wire.put(0x080, b"\x05"))
    assert report.differences == ["another program sends SYNC on this bus: stop the gateway, then check again"]
    assert all(can_id == 0x080 or can_id > 0x700 for can_id, _ in bench.wire.log)


def test_a_check_that_is_stopped_ends_the_pattern() -> None:
    bench = Bench(small_contract())
    check = NodeCheck(bench.contract, bench.contract.nodes[0], bench.wire.gateway.send, bench.now_s)
    while not pattern_of(bench):
        bench.now_s += STEP_S
        check.tick(bench.now_s)
        while bench.wire.deliver():
            bench.segment.take(bench.wire.nodes.receive(), bench.now_s)
            check.take(bench.wire.gateway.receive(), bench.now_s)
    check.give_up()
    bench.wire.deliver()
    bench.segment.take(bench.wire.nodes.receive(), bench.now_s)
    assert pattern_of(bench) == 0
