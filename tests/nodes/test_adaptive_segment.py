"""A bus of adaptive nodes without a bus: frames and times in, frames out."""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dbc.adaptive import FIRST_COB_ID, GROUP_SUMS, NODES, TPDOS, frame_of
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, Frames
from gateway.adaptive_state import BusSums, new_sums, take
from nodes.adaptive.boards import CATCH_UP, AdaptiveBoards
from nodes.adaptive.mailboxes import FRAME_BITS, LOST_NS
from nodes.adaptive.noise import LEAST_NOISE_N
from nodes.adaptive.segment import PAUSE_NS, AdaptiveSegment
from skin.layout import load_layout
from skin.sources import Frame
from skin.walsh import GROUPS, walsh_matrix
from tests.bus.harness import frame
from tests.nodes.conftest import ArrayLink

START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
IDS = (1, 2, 3, 4)
LOAD = 0x6461_6F6C


class Press:
    """Nothing, then from a step on an even force on every taxel."""

    has_noise = False

    def __init__(self, contract: Contract, from_step: int = 10, force_n: float = 0.008) -> None:
        taxels = contract.layout.taxels
        shape = taxels.rows, taxels.columns
        self._from = from_step
        # Neighbours differ, so that sums of every group do.
        self.force_n = np.random.default_rng(5).uniform(0.5, 1.5, shape).astype(np.float32) * np.float32(force_n)

    def frame(self, step: int) -> Frame:
        is_on = step >= self._from
        return Frame(self.force_n if is_on else np.zeros_like(self.force_n), "thing" if is_on else "")


class Bus:
    """Nodes 1 to 4 of bus0, the wire, a receiver, and a clock that the test moves."""

    def __init__(self, contract: Contract, **options: object) -> None:
        self.contract = contract
        self.source = Press(contract)
        blocks = [node.block for node in contract.on_bus(0) if node.node_id in IDS]
        self.boards = AdaptiveBoards(contract, blocks, self.source, noise_n=0.0, **options)  # type: ignore[arg-type]
        self.link = ArrayLink()
        self.complaints: list[str] = []
        self.segment = AdaptiveSegment(contract, 0, IDS, self.link.send, self.boards, complain=self.complaints.append)
        self.now_s = 100.0
        self.received: BusSums = new_sums(NODES)
        self.segment.boot(self.now_s)
        self.link.take_sent()

    def give(self, *arrived: Frames) -> Frames:
        """Let frames arrive, and return what the nodes answer at once."""
        self.link.take_sent()
        self.link.waiting.extend(arrived)
        self.segment.take(self.link.receive(), self.now_s)
        return self.link.take_sent()

    def run(self, ticks: int) -> Frames:
        """Go on by so many milliseconds; every frame arrives. Return frames of sums, which the receiver has taken."""
        sent = []
        for _ in range(ticks):
            self.segment.take(self.link.receive(), self.now_s)
            self.now_s += 1e-3
            self.segment.tick(self.now_s)
            sent.append(sums_of(self.link.take_sent()))
        self.segment.take(self.link.receive(), self.now_s)
        together = np.concatenate(sent)
        for one in together:
            take(int(one["can_id"]), int(one["length"]), one["data"], 0, self.contract.law, self.received)
        return together

    def start(self) -> None:
        self.give(frame(0, bytes((START, 0))))

    def sync(self, counter: int = 1) -> None:
        self.give(frame(0x80, bytes((counter,)), time_ns=round(self.now_s * 1e9)))

    def sdo(self, node_id: int, request: bytes) -> bytes:
        answers = self.give(frame(0x600 + node_id, request.ljust(8, b"\0")))
        (answer,) = answers[answers["can_id"] == 0x580 + node_id]
        return answer["data"][:8].tobytes()

    def write(self, index: int, sub: int, data: bytes, node_id: int = 1) -> int:
        answer = self.sdo(node_id, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data)
        return int(struct.unpack("<I", answer[4:])[0]) if answer[0] == 0x80 else 0

    def read(self, index: int, sub: int = 0, node_id: int = 1) -> bytes:
        answer = self.sdo(node_id, struct.pack("<BHB", 0x40, index, sub))
        assert answer[0] & 0xE0 == 0x40, answer.hex()
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        answer = self.sdo(node_id, b"\x60")  # eight bytes come in two segments
        return answer[1:] + self.sdo(node_id, b"\x70")[1:2]

    def read_real(self, index: int, sub: int = 0, node_id: int = 1) -> float:
        return float(struct.unpack("<f", self.read(index, sub, node_id))[0])


def sums_of(sent: Frames) -> Frames:
    return sent[(sent["can_id"] >= FIRST_COB_ID) & (sent["can_id"] < FIRST_COB_ID + NODES * TPDOS)]


def meanings(sent: Frames) -> list[tuple[int, int, int, bool]]:
    return [frame_of(int(one["can_id"])) for one in sent]


def back(sent: Frames, flags: int) -> Frames:
    returned = sent.copy()
    returned["flags"] |= flags
    return returned


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout(Path("adaptive"), adaptive=True))


@pytest.fixture
def bus(contract: Contract) -> Iterator[Bus]:
    made = Bus(contract)
    yield made
    assert not made.complaints


def test_nodes_filter_before_they_are_started_and_send_nothing(bus: Bus) -> None:
    bus.sync()
    assert len(bus.run(150)) == 0
    assert bus.read(0x2110, 1) != b"\0"  # pressed meanwhile


def test_a_node_that_is_started_sends_all_groups_once_and_then_again_ever_more_rarely(bus: Bus) -> None:
    bus.start()
    first = bus.run(2)
    assert sorted(meanings(first)) == sorted((node, 0, group, False) for node in IDS for group in range(GROUPS))
    later = [len(bus.run(ticks)) for ticks in (50, 20, 100, 40)]
    assert later == [0, len(first), 0, len(first)]


def test_what_a_receiver_shows_is_what_the_touch_is(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    bus.sync()
    bus.run(600)
    law = bus.contract.law
    for row, node in enumerate(bus.contract.on_bus(0)[: len(IDS)]):
        force_n = bus.source.force_n.ravel()[bus.contract.phi.taxels_of_blocks[node.block]]
        true_n = walsh_matrix(32) @ np.clip(force_n, 0, 0.02)
        assert np.abs(bus.received.value_n[row] - true_n)[1:].max() < 2 * law.fine_n
        assert abs(bus.received.value_n[row, 0] - true_n[0]) < 32 * LEAST_NOISE_N * 1.6  # an offset within the noise
        assert np.array_equal(bus.received.value_n[row], bus.boards._groups.known_n[row])
    assert bus.received.counts[1:].tolist() == [0, 0]
    assert bus.segment.frames_sent == bus.received.counts[0]
    assert bus.segment.frames_dropped == 0


def test_no_sums_in_the_millisecond_after_a_sync_and_none_waits_beyond_the_next(bus: Bus) -> None:
    bus.start()
    bus.sync()
    sync_ns = round(bus.now_s * 1e9)
    for tick in range(1, 100):
        sent = bus.run(1)
        assert (sent["time_ns"] >= sync_ns + PAUSE_NS).all()
        assert (sent["expires_ns"] <= sync_ns + 100_000_000).all()
        assert (sent["expires_ns"] - sent["time_ns"] <= 1_100_000).all(), tick


def test_a_frame_that_comes_back_unsent_is_made_anew_of_newer_samples(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    bus.sync()
    while True:
        bus.now_s += 1e-3
        bus.segment.tick(bus.now_s)
        first = sums_of(bus.link.take_sent())
        bus.link.waiting.clear()
        if len(first):
            break
    known = bus.boards._groups.known_n.copy()
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    held = {(node, group) for node, _, group, _ in meanings(first)}
    second = sums_of(bus.link.take_sent())
    assert not held & {(node, group) for node, _, group, _ in meanings(second)}  # it may still win the bus
    bus.link.waiting.clear()
    bus.give(back(first, ECHO | ERROR), back(second, ECHO | ERROR))
    assert np.array_equal(bus.boards._groups.known_n, known)
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    again = sums_of(bus.link.take_sent())
    assert held <= {(node, group) for node, _, group, _ in meanings(again)}
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (16, 0)


def test_a_frame_whose_echo_is_lost_is_given_up_in_the_end(bus: Bus) -> None:
    bus.start()
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    assert len(sums_of(bus.link.take_sent()))
    bus.link.waiting.clear()
    bus.now_s += 0.9e-9 * LOST_NS
    bus.segment.tick(bus.now_s)
    waiting = sums_of(bus.link.take_sent())
    bus.link.waiting.clear()
    bus.now_s += 0.2e-9 * LOST_NS
    bus.segment.tick(bus.now_s)
    assert len(sums_of(bus.link.take_sent())) > len(waiting)


def test_frames_that_a_full_queue_refuses_are_dropped_and_made_anew(bus: Bus) -> None:
    bus.start()
    bus.link.room = 3
    assert len(bus.run(1)) == 3
    dropped = bus.segment.frames_dropped
    assert dropped > 0
    bus.link.room = 1 << 30
    assert len(bus.run(3)) == 13
    assert (bus.segment.frames_sent, bus.segment.frames_dropped) == (16, dropped)
    by_node = [int.from_bytes(bus.read(0x2020, 2, node_id), "little") for node_id in IDS]
    lost = [int.from_bytes(bus.read(0x2020, 3, node_id), "little") for node_id in IDS]
    assert (sum(by_node), sum(lost)) == (16, dropped)


def test_stopped_nodes_send_nothing_and_begin_anew_when_they_are_started(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    for command in (PRE_OPERATIONAL, STOP):
        bus.give(frame(0, bytes((command, 0))))
        assert len(bus.run(200)) == 0
        bus.start()
        assert len(bus.run(5)) == 16


def test_groups_that_are_asked_for_are_sent_again(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    assert bus.write(0x2030, 0, b"\x05", 2) == 0
    assert bus.read(0x2030, 0, 2) == b"\x05"
    assert sorted(meanings(bus.run(3))) == [(2, 0, 0, False), (2, 0, 2, False)]
    assert bus.read(0x2030, 0, 2) == b"\0"
    assert bus.write(0x2030, 0, b"\x10", 2) == 0x0609_0030


def test_a_reset_forgets_what_was_sent_and_not_the_noise(contract: Contract) -> None:
    bus = Bus(contract)
    bus.start()
    bus.run(5)
    bus.sync()
    bus.run(300)
    assert bus.boards._groups.known_n[0].any()
    noise = bus.read_real(0x2035)
    for command in (RESET_COMMUNICATION, RESET_NODE):
        bus.give(frame(0, bytes((command, 1))))
        assert not bus.boards._groups.known_n[0].any()
        assert bus.boards._groups.known_n[1].any()
        assert bus.read_real(0x2035) == pytest.approx(noise, rel=0.3)
        assert not [each for each in meanings(bus.run(20)) if each[0] == 1]
        bus.give(frame(0, bytes((START, 1))))
        assert {(group, fine) for node, _, group, fine in meanings(bus.run(3)) if node == 1} == {
            (group, False) for group in range(GROUPS)
        }


def test_what_was_sent_before_a_reset_does_not_come_back_with_its_echo(bus: Bus) -> None:
    bus.start()
    bus.now_s += 1e-3
    bus.segment.tick(bus.now_s)
    late = bus.link.receive()
    bus.give(frame(0, bytes((RESET_COMMUNICATION, 1))))
    bus.give(late)
    assert len(bus.run(100)) > 0  # the others' refreshes
    assert bus.segment.frames_sent >= 16


def test_a_tpdo_that_does_not_exist_is_not_sent_and_one_elsewhere_is(bus: Bus, contract: Contract) -> None:
    coarse = [tpdo for tpdo in contract.nodes[0].adaptive_tpdos if (tpdo.level, tpdo.is_fine) == (0, False)]
    off, moved = (0x1800 + tpdo.number - 1 for tpdo in coarse[:2])
    assert bus.write(off, 1, struct.pack("<I", 0xC000_0000 | coarse[0].cob_id)) == 0
    assert bus.write(moved, 1, struct.pack("<I", 0xC000_0000 | coarse[1].cob_id)) == 0
    assert bus.write(moved, 1, struct.pack("<I", 0x4000_06D0)) == 0
    bus.start()
    identifiers = set()
    for _ in range(3):
        bus.now_s += 1e-3
        bus.segment.tick(bus.now_s)
        sent = bus.link.take_sent()
        identifiers |= set(sent["can_id"][sent["port"] == 1].tolist())
        bus.segment.take(bus.link.receive(), bus.now_s)
    assert identifiers == {0x6D0, coarse[2].cob_id, coarse[3].cob_id}
    assert bus.boards._groups.check[0].tolist()[1] >= 0  # its echo was known
    # The mapping, and when a TPDO is sent, are fixed.
    assert bus.write(0x1A00, 0, b"\0") == 0x0601_0002
    assert bus.write(0x1800, 2, b"\1") == 0x0601_0002


def test_inhibit_time_of_a_tpdo_is_kept(bus: Bus, contract: Contract) -> None:
    for tpdo in contract.nodes[0].adaptive_tpdos:
        record = 0x1800 + tpdo.number - 1
        assert bus.write(record, 1, struct.pack("<I", 0xC000_0000 | tpdo.cob_id)) == 0
        assert bus.write(record, 3, struct.pack("<H", 200)) == 0  # 20 ms
        assert bus.write(record, 1, struct.pack("<I", 0x4000_0000 | tpdo.cob_id)) == 0
    bus.start()
    bus.sync()
    last: dict[int, int] = {}
    seen = 0
    for tick in range(400):
        for one in bus.run(1):
            if one["port"] == 1:
                can_id = int(one["can_id"])
                assert tick - last.get(can_id, -99) >= 20
                last[can_id], seen = tick, seen + 1
    assert seen > 10


def test_the_rule_of_one_node_is_changed_by_its_objects(bus: Bus) -> None:
    assert bus.write(0x2031, 9, struct.pack("<I", 0)) == 0x0609_0030
    assert bus.write(0x2031, 1, struct.pack("<f", float("nan"))) == 0x0609_0030
    assert bus.write(0x2031, 9, struct.pack("<I", 10), 2) == 0  # refresh after 10 ms
    bus.start()
    bus.run(2)
    assert {node for node, *_ in meanings(bus.run(20))} == {2}
    # More noise for a threshold: what is pressed is no news.
    assert bus.write(0x2031, 1, struct.pack("<f", 1e6), 3) == 0
    bus.sync()
    sent = meanings(bus.run(130))
    assert {node for node, level, *_ in sent if level > 1} == {1, 2, 4}
    bus.give(frame(0, bytes((RESET_NODE, 3))), frame(0, bytes((START, 3))))
    assert 3 in {node for node, level, *_ in meanings(bus.run(5)) if level > 1}


def test_noise_that_is_written_takes_the_place_of_what_was_learned(bus: Bus) -> None:
    learned = bus.read_real(0x2032, 7)
    assert bus.read_real(0x2035) == pytest.approx(learned)
    for place in range(1, 33):
        assert bus.write(0x2032, place, struct.pack("<f", 1e-3)) == 0
        assert bus.write(0x2033, place, struct.pack("<f", 2e-3)) == 0
    bus.run(300)
    assert bus.read_real(0x2035) == pytest.approx(1e-3)
    assert bus.read_real(0x2033, 32) == pytest.approx(2e-3)
    assert bus.read_real(0x2035, node_id=2) == pytest.approx(learned)
    for place in range(1, 33):
        assert bus.write(0x2032, place, struct.pack("<f", 0)) == 0
    assert bus.read_real(0x2035) == pytest.approx(learned)
    assert bus.read_real(0x2033, 1) == pytest.approx(2e-3)
    assert bus.write(0x2032, 1, struct.pack("<f", -1)) == 0x0609_0030


def test_codes_are_those_that_frames_carry(bus: Bus) -> None:
    bus.start()
    bus.sync()
    bus.run(400)
    law, known_n = bus.contract.law, bus.boards._groups.known_n[0]
    coarse = [int(bus.read(0x2110, place)[0]) for place in range(1, 33)]
    fine = [bus.read(0x2111, group + 1) for group in range(GROUPS)]
    mine = new_sums(1)
    for group in range(GROUPS):
        for number, payload in ((group, bytes(coarse[GROUP_SUMS * group :][:GROUP_SUMS])), (28 + group, fine[group])):
            data = np.frombuffer(payload.ljust(8, b"\0"), np.uint8)
            assert take(FIRST_COB_ID + NODES * number, 8, data, 0, law, mine)
    held = mine.value_n[0]
    refined = mine.counts[1] == 0
    assert np.abs(held - known_n).max() <= 2 * law.fine_n if refined else True
    assert mine.counts[2] == 0


def test_a_node_keeps_its_budget(contract: Contract) -> None:
    bus = Bus(contract)
    assert bus.write(0x2034, 0, struct.pack("<I", 20 * FRAME_BITS)) == 0
    bus.start()
    bus.sync()
    sent = [each for each in meanings(bus.run(1100)) if each[0] in {1, 2}]
    limited, free = ([each for each in sent if each[0] == node] for node in (1, 2))
    assert len(limited) < 8 + 22 + 2 * GROUPS * 5  # saved up, earned, refreshes
    assert len(limited) < len(free)
    assert {group for _, _, group, _ in limited} == set(range(GROUPS))


def test_a_late_process_takes_missed_samples_up_to_a_bound_and_decides_once(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    samples = bus.boards.decision
    bus.now_s += 10.5e-3
    bus.segment.tick(bus.now_s)
    assert bus.boards.samples_skipped == 0
    assert bus.boards.decision - samples in {10, 11}
    bus.link.take_sent()
    bus.now_s += 1.0
    bus.segment.tick(bus.now_s)
    assert abs(bus.boards.samples_skipped - (1000 - CATCH_UP)) <= 1
    assert len(sums_of(bus.link.take_sent())) <= 16


def test_truth_is_told_for_every_step_of_the_touch(bus: Bus) -> None:
    bus.run(3)
    assert bus.boards.take_truth() is None
    bus.sync(counter=3)
    begin_ns = round(bus.now_s * 1e9) - 200_000_000
    bus.run(100)
    truths = []
    while (truth := bus.boards.take_truth()) is not None:
        truths.append(truth)
    assert [truth.step for truth in truths] == list(range(truths[0].step, truths[0].step + 10))
    assert truths[0].step in {20, 21}
    for truth in truths:
        assert (truth.sync_counter, truth.sync_mono_ns) == (0, begin_ns + truth.step * 10_000_000)
        assert truth.label == "thing"
        assert np.array_equal(np.frombuffer(truth.true, "<f4"), bus.source.force_n.ravel())
    sensor_n = np.frombuffer(truths[-1].sensor, "<f4")
    cells = bus.contract.phi.taxels_of_blocks[[node.block for node in bus.contract.on_bus(0)[: len(IDS)]]]
    assert np.abs(sensor_n[cells] - np.clip(bus.source.force_n.ravel()[cells], 0, 0.02)).max() < 2e-5


def test_test_patterns_and_corrections_show_in_the_sums(bus: Bus) -> None:
    bus.run(300)
    assert bus.write(0x2021, 0, b"\3") == 0
    bus.run(50)
    full_n = 32 * 0.02
    shown = np.frombuffer(bus.boards.sums.astype("<i4").tobytes(), "<i4")[: bus.contract.phi.block_size]
    assert shown[0] * bus.contract.layout.taxels.newton_per_count == pytest.approx(full_n, rel=0.01)
    assert int.from_bytes(bus.read(0x2020, 4), "little") == 32
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    bus.run(300)
    assert int.from_bytes(bus.read(0x2020, 4), "little") == 0


def test_parameters_are_stored_and_orders_are_not(tmp_path: Path, contract: Contract) -> None:
    bus = Bus(contract)
    assert bus.write(0x2034, 0, struct.pack("<I", 4000)) == 0
    assert bus.write(0x2030, 0, b"\x0f") == 0
    assert bus.write(0x1010, 1, b"save") == 0
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    assert int.from_bytes(bus.read(0x2034), "little") == 4000
    assert bus.boards._boxes.budget[0] == 4000
    assert bus.read(0x2030) == b"\0"
    assert bus.write(0x1011, 1, struct.pack("<I", LOAD)) == 0
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    assert bus.boards._boxes.budget[0] == 0
