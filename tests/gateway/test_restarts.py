"""When the gateway tries to restart a node, and what it says of it: one node whose answers are the test's."""

import pytest

from canskin.messages import SILENT
from dbc.canopen import NmtState
from dbc.configuration import configuration, expected_signature
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from gateway.nmt_master import NmtMaster
from tests.bus.harness import frame
from tests.layouts import buses, small_contract, small_layout

#: The gateway looks at its nodes every 10 ms.
TICK_S = 0.01


class Bench:
    """The gateway's NMT master, and node 1, which answers what it is asked at once; alone on its bus."""

    def __init__(self) -> None:
        contract = small_contract(bus=buses(1, 1, blocks_per_node=2))
        (node,) = contract.on_bus(0)
        self.signature = expected_signature(configuration(contract, node))
        self.now_s = 0.0
        self.lines: list[str] = []
        self.trusted = False
        #: Times of commands, and of questions about the signature.
        self.commands: list[tuple[float, int, int]] = []
        self.questions: list[float] = []
        self.answers, self.boots, self.beats = True, False, True
        self.state: NmtState | None = None
        self._waiting: list[Frames] = []
        self._beat_s = 0.0
        self.master = NmtMaster(contract, 0, self._send, self._trust, self.lines.append)

    def _trust(self, _node: object, is_trusted: bool) -> None:
        self.trusted = is_trusted

    def _send(self, can_id: int, data: bytes) -> None:
        if can_id == 0x000:
            self.commands.append((round(self.now_s, 2), data[0], data[1]))
            self.state = {1: NmtState.OPERATIONAL, 0x80: NmtState.PRE_OPERATIONAL}.get(data[0])
            if data[0] == 1 and self.boots:
                self._waiting.append(frame(0x701, b"\0"))
                self.state = NmtState.PRE_OPERATIONAL
        elif can_id == 0x601 and data[:4] == b"\x40\x06\x20\0":
            self.questions.append(round(self.now_s, 2))
            if self.answers:
                self._waiting.append(frame(0x581, b"\x43\x06\x20\0" + self.signature.to_bytes(4, "little")))

    def go(self, seconds: float, step_s: float = TICK_S) -> None:
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            self.master.tick(self.now_s)
            if self.beats and self.state is not None and self.now_s >= self._beat_s:
                self._waiting.append(frame(0x701, bytes((self.state,))))
                self._beat_s = self.now_s + 1.0
            while self._waiting:
                self.master.take(self._waiting.pop(0), self.now_s)

    def hear(self, can_id: int, data: bytes, flags: int = 0) -> None:
        self.master.take(frame(can_id, data, flags), self.now_s)


@pytest.fixture
def bench() -> Bench:
    """Return a bench whose node is in use."""
    built = Bench()
    built.go(0.5)
    assert built.trusted
    return built


def test_a_node_that_boots_after_each_start_gets_eight_pauses_and_then_a_try_a_minute(bench: Bench) -> None:
    bench.commands.clear()
    bench.boots = True
    began_s = bench.now_s
    bench.hear(0x701, b"\0")
    bench.go(22)
    bench.go(121, 0.02)
    starts_s = [time_s - began_s for time_s, *command in bench.commands if command == [1, 1]]
    pauses_s = [after - before for before, after in zip([0.0, *starts_s], starts_s, strict=False)]
    assert pauses_s == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 60.0, 60.0], abs=0.025)
    given_up = [line for line in bench.lines if "given up" in line]
    assert given_up == ["node 1 on bus0 given up after 8 tries: tried again every 60 s"]


@pytest.mark.parametrize(("stable_s", "pause_s"), [(9.9, 0.2), (10.1, 0.1)])
def test_pauses_begin_anew_after_ten_seconds_in_operational(bench: Bench, stable_s: float, pause_s: float) -> None:
    bench.hear(0x701, b"\0")
    bench.go(0.12)
    assert bench.trusted
    bench.go(stable_s - 0.02)
    bench.hear(0x701, b"\0")
    bench.go(pause_s - 0.02)
    assert not bench.trusted
    bench.go(0.04)
    assert bench.trusted


def test_a_node_is_looked_at_every_ten_milliseconds(bench: Bench) -> None:
    bench.hear(0x701, b"\0")
    bench.go(0.5, 0.001)
    bench.hear(0x701, b"\0")
    before = len(bench.questions)
    bench.master.tick(bench.now_s + 10.0)
    assert len(bench.questions) == before + 1
    bench.hear(0x701, b"\0")
    bench.master.nodes[1].prove_at_s = 0.0
    bench.master.tick(bench.now_s + 10.005)
    assert len(bench.questions) == before + 1
    bench.master.tick(bench.now_s + 10.011)
    assert len(bench.questions) == before + 2


@pytest.mark.parametrize(("age_s", "why"), [(1.9, " after EMCY 8130h"), (2.1, "")])
def test_an_emergency_of_the_last_two_seconds_explains_why_a_node_left(bench: Bench, age_s: float, why: str) -> None:
    bench.hear(0x081, bytes((0x30, 0x81, 0x11, 0, 0, 0, 0, 0)))
    bench.go(age_s)
    bench.hear(0x701, b"\x7f")
    bench.go(0.3)
    assert bench.lines[0] == f"node 1 on bus0 left OPERATIONAL: pre-operational{why}"


def test_an_emergency_that_ended_explains_nothing(bench: Bench) -> None:
    bench.hear(0x081, bytes((0x30, 0x81, 0x11, 0, 0, 0, 0, 0)))
    bench.hear(0x081, bytes(8))
    assert bench.master.emergencies == [(1, 0x8130)]
    assert bench.master.emcy == [0]
    bench.hear(0x701, b"\0")
    bench.go(0.3)
    assert bench.lines[0] == "node 1 on bus0 booted again"


@pytest.mark.parametrize(("after_s", "state"), [(1.4999, NmtState.OPERATIONAL), (1.5001, SILENT)])
def test_a_node_without_heartbeat_is_silent_after_a_second_and_a_half(bench: Bench, after_s: float, state: int) -> None:
    bench.hear(0x701, b"\5")
    bench.master.tick(bench.now_s + after_s)
    assert bench.master.nmt.tolist() == [state]
    assert bench.trusted == (state != SILENT)


@pytest.mark.parametrize(("beat", "soon_s"), [(b"\0", 0.12), (b"\x7f", 0.02)])
def test_a_silent_node_that_is_heard_again_is_tried_as_at_first(bench: Bench, beat: bytes, soon_s: float) -> None:
    bench.beats = bench.answers = False
    bench.go(8)
    assert bench.master.nodes[1].tries > 3
    bench.hear(0x701, beat)
    bench.questions.clear()
    bench.go(soon_s)
    assert len(bench.questions) == 1
    bench.go(1.2)
    # Three attempts of 0.3 s, and a pause of 0.2 s.
    times_s = [time_s - bench.questions[0] for time_s in bench.questions]
    assert times_s == pytest.approx([0.0, 0.3, 0.6, 1.1], abs=0.05)


def test_a_silent_node_is_told_to_answer_before_it_is_asked_again(bench: Bench) -> None:
    """It may be STOPPED, and then answers no SDO."""
    bench.hear(0x701, b"\5")
    bench.beats = bench.answers = False
    bench.go(1.55)
    assert not bench.trusted
    bench.questions.clear()
    bench.commands.clear()
    began_s = bench.now_s
    bench.go(1.5)
    # One attempt of 0.3 s each, after pauses of 0.1 s, 0.2 s, 0.4 s; the node was lost 0.04 s ago.
    assert [time_s - began_s for time_s in bench.questions] == pytest.approx([0.06, 0.56, 1.26], abs=0.045)
    assert bench.commands == [(time_s, 0x80, 1) for time_s in bench.questions[1:]]


def test_a_node_is_in_use_for_two_rounds_of_proofs_and_three_attempts(bench: Bench) -> None:
    bench.go(12)
    assert bench.trusted
    bench.answers = False
    proven_s = bench.questions[-1]  # rounds are 2 s, an attempt is 0.3 s: 2 * 2 s + 3 * 0.3 s
    bench.go(proven_s + 4.9 - 0.02 - bench.now_s)
    assert bench.trusted
    bench.go(0.04)
    assert not bench.trusted
    bench.go(0.25)
    assert bench.lines[0] == "node 1 on bus0 not proven for 5 s"


def test_a_refused_node_is_read_again_after_a_minute(bench: Bench) -> None:
    right = bench.signature
    bench.hear(0x701, b"\0")
    bench.master.nodes[1].refusal = "1018h:1 differs"
    bench.master.nodes[1].prove_at_s = bench.now_s + 60.0
    assert bench.master.refused == [1]
    assert bench.master.awaited == []
    bench.hear(0x701, b"\x05")
    bench.go(0.02)
    assert bench.commands[-1][1:] == (0x80, 1)  # its PDOs may be those of another node
    told = len(bench.commands)
    bench.go(0.05)
    assert len(bench.commands) == told
    assert bench.signature == right
    bench.go(58.9)
    assert bench.master.refused == [1]
    bench.go(2.0)
    assert (bench.master.refused, bench.trusted) == ([], True)


@pytest.mark.parametrize(
    ("command", "lost"),
    [
        (0x02, "left OPERATIONAL: stopped, by another master's NMT command"),
        (0x80, "left OPERATIONAL: pre-operational, by another master's NMT command"),
        (0x01, ""),
        (0x81, ""),
        (0x82, ""),
        (0x07, ""),
    ],
)
def test_commands_of_another_master(bench: Bench, command: int, lost: str) -> None:
    bench.hear(0x000, bytes((command, 1)))
    assert bench.trusted == (not lost)
    bench.go(0.3)
    assert bench.lines[:1] == [f"node 1 on bus0 {lost}"] * bool(lost)
    bench.hear(0x000, bytes((command, 2)))
    bench.hear(0x000, bytes((command, 1, 0)))
    assert bench.trusted
    if command in {0x81, 0x82}:
        bench.hear(0x701, b"\0")
        bench.go(0.3)
        assert bench.lines[0] == "node 1 on bus0 booted again, reset by another master"


def test_a_transfer_that_another_master_begins_keeps_the_gateway_from_asking(bench: Bench) -> None:
    bench.hear(0x701, b"\0")
    bench.questions.clear()
    bench.go(0.09)
    bench.hear(0x601, b"\x40\x18\x10\1" + bytes(4))
    bench.answers = False
    bench.go(0.03)
    assert len(bench.questions) == 1
    bench.hear(0x601, b"\x40\x18\x10\1" + bytes(4))  # the node answers one client at a time
    assert bench.master.nodes[1].dialogue is None
    asked_s = bench.now_s
    bench.answers = True
    bench.go(0.03)
    assert len(bench.questions) == 1
    bench.go(0.04)
    assert bench.questions[1:] == pytest.approx([asked_s + 0.05], abs=0.011)
    assert bench.trusted


@pytest.mark.parametrize("size", [7, 8])
def test_only_a_whole_emergency_counts(bench: Bench, size: int) -> None:
    bench.hear(0x081, b"\x30\x81".ljust(size, b"\0"))
    assert bench.master.emergencies == [(1, 0x8130)] * (size == 8)
    bench.hear(0x101, bytes((0x10, 0xFF, 0, 0, 0, 0, 0, 0)))
    bench.hear(0x67F, bytes((0x10, 0xFF, 0, 0, 0, 0, 0, 0)))
    assert bench.master.emcy == [0x8130 * (size == 8)]


def test_a_node_that_was_started_before_is_not_under_way_after_a_new_start(bench: Bench) -> None:
    """Its heartbeat may still have the old state until the new start is on the bus."""
    bench.master.nodes[1].started_ns = 5
    bench.hear(0x701, b"\0")
    bench.beats = False
    bench.go(0.15)
    assert bench.trusted
    bench.master.take(frame(0x701, b"\x7f", time_ns=900_000_000), bench.now_s)
    assert bench.trusted
    bench.master.take(frame(0x000, b"\1\1", ECHO, time_ns=1_000_000_000), bench.now_s)
    bench.master.take(frame(0x701, b"\x7f", time_ns=1_299_999_999), bench.now_s)
    assert bench.trusted
    bench.master.take(frame(0x701, b"\x7f", time_ns=1_300_000_000), bench.now_s)
    assert not bench.trusted


def test_sixteen_nodes_are_asked_at_the_same_time() -> None:
    asked: list[int] = []
    contract = Contract.from_layout(small_layout(64, 64, bus=buses(64, 64)))
    master = NmtMaster(contract, 0, lambda can_id, _: asked.append(can_id), lambda *_: None, lambda _: None)
    master.tick(0.0)
    assert asked == [0x600 + node_id for node_id in range(1, 17)]


def test_after_the_end_of_a_block_download_another_master_reads_without_harm(bench: Bench) -> None:
    bench.hear(0x601, b"\xc2\x07\x10\0\4\0\0\0")
    assert not bench.trusted
    bench.hear(0x581, b"\xa1" + bytes(7))
    bench.go(0.3)
    assert bench.trusted
    bench.hear(0x601, b"\x40\x18\x10\1" + bytes(4))
    assert bench.trusted
    bench.go(0.3)
    assert [line for line in bench.lines if "doubted" in line] == [
        "node 1 on bus0 doubted: another master writes its configuration"
    ]
