"""The states of a node, one by one: a master, its clock, and boards that do nothing but answer SDO."""

from collections.abc import Generator
from itertools import pairwise

import pytest

from canskin.messages import SILENT
from dbc import indices as od
from dbc.canopen import NmtCommand, NmtState
from dbc.configuration import TICK_S, configuration, expected_signature
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from gateway.nmt_master import NmtMaster
from gateway.node_machine import NodeMachine
from gateway.proof import PART
from gateway.sdo import Read, SdoTimeoutError, Transfer
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.layouts import buses, small_contract

#: The times that docs/bus.md promises.
PROOF_PERIOD_S = 2.0
PAUSES_S = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0)
LATER_S = 60.0
#: After its start for a heartbeat that was under way, and after an emergency for what it explains.
UNDER_WAY_S = 0.3
EXPLAINS_S = 2.0
#: After another master's SDO, before the gateway asks the same node.
SDO_QUIET_S = 0.05

NO_SUBINDEX = 0x0609_0011
TOO_SOON_S = 1e-6
NMT, EMCY, ANSWER, REQUEST, HEARTBEAT = 0x000, 0x080, 0x580, 0x600, 0x700
START, STOP, PRE_OPERATIONAL, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x82
BOOTED, STOPPED, OPERATIONAL, PRE = 0, 4, 5, 127


class Boards:
    """The boards of bus0, their master and its clock; every answer comes at once."""

    def __init__(self, contract: Contract) -> None:
        self.now_s = 100.0
        self.lines: list[str] = []
        #: Times of requests by node-ID.
        self.asked_s: dict[int, list[float]] = {}
        #: Boards that answer no SDO, and those whose configuration is not right.
        self.mute: set[int] = set()
        self.wrong: set[int] = set()
        #: NMT commands; boards of `plain` compute no signature, and answer what the contract says.
        self.commands: list[tuple[int, int]] = []
        self.plain: set[int] = set()
        self._rest = b""
        self._answers: list[tuple[int, bytes]] = []
        self._signatures = {
            node.node_id: expected_signature(configuration(contract, node)).to_bytes(4, "little")
            for node in contract.on_bus(0)
        }
        self.master = NmtMaster(contract, 0, self._send, lambda *_: None, self.lines.append)
        self._beat_s = self.now_s

    def _send(self, can_id: int, data: bytes) -> None:
        if can_id == NMT:
            self.commands.append((data[0], data[1]))
            self.hear(can_id, data, ECHO)
            return
        node_id = can_id - REQUEST
        self.asked_s.setdefault(node_id, []).append(self.now_s)
        if node_id in self.mute or data[0] & 0xE0 == 0x80:
            return
        if node_id in self.plain:
            self._answers.append((ANSWER + node_id, self._plain_answer(node_id, data)))
            return
        is_signature = int.from_bytes(data[1:3], "little") in {od.SIGNATURE, od.CALIBRATION_SIGNATURE}
        if not is_signature:
            answer = b"\x80" + data[1:4] + NO_SUBINDEX.to_bytes(4, "little")
        else:
            answer = b"\x43" + data[1:4] + (b"\1\2\3\4" if node_id in self.wrong else self._signatures[node_id])
        self._answers.append((ANSWER + node_id, answer))

    def hear(self, can_id: int, data: bytes, flags: int = 0) -> None:
        self.master.take(frame(can_id, data, flags, time_ns=round(self.now_s * 1e9)), self.now_s)

    def run(self, seconds: float, *, beating: bool = True) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            if beating and self.now_s >= self._beat_s:
                self._beat_s = self.now_s + 1.0
                for node_id in self.master.node_ids:
                    self.hear(HEARTBEAT + node_id, bytes((NmtState.OPERATIONAL,)))
            self.master.tick(self.now_s)
            while self._answers:
                self.hear(*self._answers.pop())

    def trusted(self) -> list[int]:
        return [node_id for node_id, node in self.master.nodes.items() if node.in_use]

    def _plain_answer(self, node_id: int, asked: bytes) -> bytes:
        if asked[0] & 0xE0 == 0x60:
            part, self._rest = self._rest[:7], self._rest[7:]
            return bytes((asked[0] & 0x10 | 7 - len(part) << 1 | (not self._rest),)) + part.ljust(7, b"\0")
        index, subindex = int.from_bytes(asked[1:3], "little"), asked[3]
        if index in {od.SIGNATURE, od.CALIBRATION_SIGNATURE}:
            return b"\x43" + asked[1:4] + bytes(4)
        record = self.master.nodes[node_id]
        settings = [*record.settings, *record.known.settings]
        (value,) = {each.data for each in settings if (each.index, each.subindex) == (index, subindex)}
        if len(value) > 4:
            self._rest = value
            return b"\x41" + asked[1:4] + len(value).to_bytes(4, "little")
        return bytes((0x43 | 4 - len(value) << 2,)) + asked[1:4] + value.ljust(4, b"\0")

    def node(self, node_id: int) -> NodeMachine:
        return self.master.nodes[node_id]

    def beat(self, node_id: int, state: int) -> None:
        self.hear(HEARTBEAT + node_id, bytes((state,)))

    def lines_now(self) -> list[str]:
        """Return the lines since the last call, with those that wait for others."""
        self.master.stop()
        stops = [(PRE_OPERATIONAL, node_id) for node_id in self.master.nodes]
        assert [self.commands.pop() for _ in stops] == stops[::-1]
        lines = [*self.lines]
        self.lines.clear()
        return lines


@pytest.fixture
def skin(small: Contract) -> Boards:
    """Return nodes 1 and 2 of bus0, proven and running, 0.5 s after their start."""
    built = Boards(small)
    built.run(0.5, beating=False)
    assert built.trusted() == [1, 2]
    return built


def request(command: int, index: int, subindex: int = 0) -> bytes:
    return bytes((command,)) + index.to_bytes(2, "little") + bytes((subindex, 0, 0, 0, 0))


def test_every_node_is_proven_once_a_round(skin: Boards) -> None:
    skin.asked_s.clear()
    skin.run(10 * PROOF_PERIOD_S)
    for times_s in skin.asked_s.values():
        assert len(times_s) in {10, 11}
        assert all(later - earlier == pytest.approx(PROOF_PERIOD_S, abs=0.05) for earlier, later in pairwise(times_s))
    assert skin.lines == []


def test_node_that_proves_nothing_any_more_is_believed_for_the_stated_time(skin: Boards) -> None:
    skin.mute.add(1)
    limit_s = skin.master.proof_limit_s
    proven_s = skin.master.nodes[1].proven_s
    skin.run(proven_s + limit_s - 2 * TICK_S - skin.now_s)
    assert skin.trusted() == [1, 2]
    skin.run(4 * TICK_S)
    assert skin.trusted() == [2]
    skin.run(0.3)
    assert skin.lines == ["node 1 on bus0 not proven for 5 s"]


def test_stated_time_is_4_9_s_for_32_nodes_at_1_mbit() -> None:
    contract = Contract.from_layout(load_layout())
    master = NmtMaster(contract, 0, lambda *_: None, lambda *_: None, lambda _: None)
    assert master.proof_limit_s == pytest.approx(4.9)


@pytest.mark.parametrize("command", [0x2F, 0x21, 0xC2], ids=["expedited", "in segments", "in blocks"])
@pytest.mark.parametrize("index", [od.TPDO_MAPPING, od.TEST_PATTERN])
def test_write_of_another_master_is_doubted_from_its_first_frame_on(skin: Boards, command: int, index: int) -> None:
    skin.hear(REQUEST + 1, request(command, index, 1))
    assert skin.trusted() == [2]
    skin.asked_s.clear()
    skin.run(SDO_QUIET_S + PAUSES_S[0] + 3 * TICK_S)
    assert skin.trusted() == [1, 2]


@pytest.mark.parametrize("command", [0x2F, 0x21, 0xC2], ids=["expedited", "in segments", "in blocks"])
def test_write_of_what_is_not_compared_is_not_doubted(skin: Boards, command: int) -> None:
    skin.hear(REQUEST + 1, request(command, od.EMCY_INHIBIT_100US))
    skin.run(0.02)
    skin.hear(REQUEST + 1, b"\x01" + bytes(7))  # its data
    assert skin.trusted() == [1, 2]


def test_proof_gives_way_to_another_master_and_is_begun_again(skin: Boards) -> None:
    skin.mute.update({1, 2})
    skin.asked_s.clear()
    while not skin.asked_s:
        skin.run(TICK_S)
    (node_id,) = skin.asked_s
    skin.hear(REQUEST + node_id, request(0x40, 0x1000))
    skin.mute.clear()
    began_s = skin.now_s
    skin.run(SDO_QUIET_S - 2 * TICK_S)
    assert len(skin.asked_s[node_id]) == 1
    skin.run(PROOF_PERIOD_S)
    assert began_s + SDO_QUIET_S <= skin.asked_s[node_id][1] < began_s + PROOF_PERIOD_S
    assert skin.trusted() == [1, 2]


def test_refused_node_is_asked_again_after_a_minute(small: Contract) -> None:
    skin = Boards(small)
    skin.wrong.add(2)
    skin.run(0.5)
    assert (skin.trusted(), skin.master.refused) == ([1], [2])
    skin.wrong.clear()
    last_s = skin.asked_s[2][-1]
    skin.run(last_s + LATER_S - 2 * TICK_S - skin.now_s)
    assert skin.asked_s[2][-1] == last_s
    skin.run(4 * TICK_S)
    assert (skin.trusted(), skin.master.refused) == ([1, 2], [])


def test_refused_node_that_is_written_to_is_asked_again_at_once(small: Contract) -> None:
    skin = Boards(small)
    skin.wrong.add(2)
    skin.run(0.5)
    skin.wrong.clear()
    skin.hear(REQUEST + 2, request(0x23, od.TPDO_MAPPING, 1))
    last_s = skin.asked_s[2][-1]
    skin.run(SDO_QUIET_S - 2 * TICK_S)
    assert skin.asked_s[2][-1] == last_s  # what the other master has begun may go on
    skin.run(4 * TICK_S)
    assert (skin.trusted(), skin.master.refused) == ([1, 2], [])


def test_heartbeat_from_before_the_start_is_no_news_for_a_short_while(skin: Boards) -> None:
    skin.hear(HEARTBEAT + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    skin.run(0.5, beating=False)
    assert skin.trusted() == [1, 2]
    used_since_s = skin.master.nodes[1].used_since_s
    skin.now_s = used_since_s + UNDER_WAY_S - TOO_SOON_S
    skin.hear(HEARTBEAT + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    assert skin.trusted() == [1, 2]
    skin.now_s = used_since_s + UNDER_WAY_S + TOO_SOON_S
    skin.hear(HEARTBEAT + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    assert skin.trusted() == [2]


@pytest.mark.parametrize(("ago_s", "words"), [(EXPLAINS_S - 0.01, " after EMCY 8130h"), (EXPLAINS_S + 0.01, "")])
def test_emergency_explains_what_follows_soon(skin: Boards, ago_s: float, words: str) -> None:
    skin.hear(EMCY + 1, bytes.fromhex("3081110000000000"))
    skin.now_s += ago_s
    skin.hear(HEARTBEAT + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    skin.run(0.3)
    assert skin.lines[0] == f"node 1 on bus0 left OPERATIONAL: pre-operational{words}"


def test_emergency_that_is_over_explains_nothing(skin: Boards) -> None:
    skin.hear(EMCY + 1, bytes.fromhex("3081110000000000"))
    skin.hear(EMCY + 1, bytes(8))
    skin.now_s += 0.5
    skin.hear(HEARTBEAT + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    skin.run(0.3)
    assert skin.lines[0] == "node 1 on bus0 left OPERATIONAL: pre-operational"


def test_node_that_was_given_up_is_tried_at_once_when_somebody_resets_it(skin: Boards) -> None:
    skin.mute.add(1)
    skin.now_s += 1.0
    skin.hear(HEARTBEAT + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    skin.run(40.0)
    assert "node 1 on bus0 given up after 8 tries: tried again every 60 s" in skin.lines
    skin.mute.clear()
    skin.run(5.0)
    assert skin.trusted() == [2]
    skin.hear(NMT, bytes((NmtCommand.RESET_NODE, 1)))
    skin.hear(HEARTBEAT + 1, b"\0")
    skin.run(PAUSES_S[0] + 3 * TICK_S)
    assert skin.trusted() == [1, 2]


# Commands on the bus


def test_a_command_to_a_silent_node_tells_nothing_of_it(small: Contract) -> None:
    skin = Boards(small)
    skin.hear(NMT, bytes((STOP, 0)))
    assert skin.master.nmt.tolist() == [SILENT, SILENT]


# Heartbeats


def test_a_heartbeat_has_one_byte_and_its_highest_bit_is_no_part_of_the_state(small: Contract) -> None:
    skin = Boards(small)
    skin.hear(HEARTBEAT + 1, bytes((OPERATIONAL, 0)))
    skin.hear(HEARTBEAT + 1, b"")
    skin.hear(HEARTBEAT + 9, bytes((OPERATIONAL,)))
    assert skin.master.nmt.tolist() == [SILENT, SILENT]
    skin.hear(HEARTBEAT + 2, bytes((0x80 | OPERATIONAL,)))
    assert skin.master.nmt.tolist() == [SILENT, OPERATIONAL]


def test_a_node_is_silent_a_second_and_a_half_after_its_heartbeat(skin: Boards) -> None:
    skin.beat(1, OPERATIONAL)
    skin.now_s += 0.25
    skin.beat(2, OPERATIONAL)
    skin.master.tick(skin.now_s + 1.249)
    assert skin.trusted() == [1, 2]
    skin.master.tick(skin.now_s + 1.2601)
    assert skin.trusted() == [2]
    assert skin.master.nmt.tolist() == [SILENT, OPERATIONAL]
    assert "node 1 on bus0 silent: no heartbeat for 1.5 s" in skin.lines_now()


# What is told


def test_emergencies_are_kept_with_their_codes(skin: Boards) -> None:
    skin.hear(EMCY + 2, bytes.fromhex("3081110000000000"))
    skin.hear(EMCY + 1, bytes.fromhex("10ff8100000000"))  # seven bytes
    skin.hear(EMCY + 9, bytes.fromhex("10ff810000000000"))
    assert (skin.master.emergencies, skin.master.emcy) == ([(2, 0x8130)], [0, 0x8130])
    skin.hear(EMCY + 2, bytes(8))
    assert (skin.master.emergencies, skin.master.emcy) == ([(2, 0x8130)], [0, 0])


def test_stop_commands_all_nodes_to_pre_operational_and_tells_what_waits(skin: Boards) -> None:
    skin.commands.clear()
    skin.hear(0x701, b"\0")
    assert skin.lines == []
    skin.master.stop()
    assert skin.commands[-2:] == [(PRE_OPERATIONAL, 1), (PRE_OPERATIONAL, 2)]
    assert len(skin.lines) == 1


def test_a_loss_of_unknown_state_is_told_by_its_number(skin: Boards) -> None:
    skin.now_s += 1.0
    skin.beat(1, 6)
    assert skin.lines_now() == ["node 1 on bus0 left OPERATIONAL: state 6"]


def test_a_stopped_node_is_commanded_to_pre_operational_before_it_is_asked(skin: Boards) -> None:
    skin.commands.clear()
    skin.now_s += 1.0
    skin.beat(1, STOPPED)
    skin.beat(2, PRE)
    skin.run(0.2, beating=False)
    assert skin.trusted() == [1, 2]
    assert skin.commands[0] == (PRE_OPERATIONAL, 1)
    assert sorted(skin.commands[1:]) == [(START, 1), (START, 2)]
    assert skin.lines_now() == [
        "node 1 on bus0 left OPERATIONAL: stopped",
        "node 2 on bus0 left OPERATIONAL: pre-operational",
        "nodes 1-2 on bus0 back after 0.1 s",
    ]


def test_a_refused_node_that_runs_is_stopped_from_running(small: Contract) -> None:
    skin = Boards(small)
    skin.wrong.add(2)
    skin.run(0.1, beating=False)
    assert skin.master.refused == [2]
    assert skin.master.awaited == []
    skin.beat(2, PRE)
    skin.run(0.1, beating=False)
    assert skin.commands == [(START, 1)]
    skin.beat(2, OPERATIONAL)
    skin.run(0.1, beating=False)
    assert skin.commands == [(START, 1), (PRE_OPERATIONAL, 2)]
    assert skin.master.nmt.tolist() == [OPERATIONAL, PRE]


def test_the_same_refusal_is_told_once(small: Contract) -> None:
    skin = Boards(small)
    skin.wrong.add(2)
    skin.run(62.0)
    assert len(skin.asked_s[2]) > 3
    assert [line.split(":")[0] for line in skin.lines] == ["node 2 on bus0 refused"]


# Proofs


def test_a_proof_without_signature_costs_as_much_as_its_transfers(small: Contract) -> None:
    skin = Boards(small)
    skin.plain.add(2)
    skin.run(0.5)
    assert skin.trusted() == [1, 2]
    # Every object, the signature that it has not, and some of its gains and offsets.
    transfers = len(skin.node(2).settings) + 1 + PART
    assert [skin.node(node_id).cost for node_id in (1, 2)] == [1, transfers]
    # Two rounds of 2 s for a proof of one transfer, and three attempts of 0.3 s.
    assert skin.master.proof_limit_s == pytest.approx(4.0 * (1 + transfers) / 2 + 0.9)


def test_a_proof_holds_from_its_oldest_read(small: Contract) -> None:
    skin = Boards(small)
    skin.plain.add(2)
    skin.mute.update({1, 2})
    skin.run(0.2, beating=False)
    for node_id in (1, 2):
        skin.beat(node_id, PRE)
    skin.run(0.5, beating=False)
    asked_s = {node_id: skin.asked_s[node_id][-1] for node_id in (1, 2)}
    skin.mute.clear()
    skin.run(1.0, beating=False)
    assert skin.trusted() == [1, 2]
    assert skin.node(1).proven_s == skin.asked_s[1][-1] > asked_s[1]
    assert skin.node(2).proven_s == skin.node(2).began_s < skin.asked_s[2][-1]


def alone() -> Boards:
    """Return the only node of a bus, proven, whose proofs begin every 2 s."""
    built = Boards(small_contract(bus=buses(1, 1, blocks_per_node=2)))
    built.run(0.5)
    assert built.trusted() == [1]
    return built


def test_after_a_long_proof_the_bus_is_left_to_others_for_as_many_turns_as_it_had_transfers() -> None:
    skin = alone()
    skin.node(1).cost = 2
    skin.asked_s.clear()
    skin.run(11.0)
    pauses_s = [later - sooner for sooner, later in pairwise(skin.asked_s[1])]
    assert pauses_s == pytest.approx([4.0, 2.0, 2.0], abs=0.03)


def test_another_master_puts_a_proof_off_by_one_round_at_most() -> None:
    skin = alone()
    skin.asked_s.clear()
    for _ in range(220):
        skin.hear(REQUEST + 1, request(0x40, 0x1000))
        skin.run(0.04)
    proven_s = [100.01, *skin.asked_s[1], skin.now_s]
    assert all(later - sooner < 4.1 for sooner, later in pairwise(proven_s))
    assert proven_s[1] > 104.0  # it would have been 102.0
    assert skin.trusted() == [1]


def test_nodes_are_awaited_until_they_are_proven_or_refused(small: Contract) -> None:
    skin = Boards(small)
    skin.mute.add(1)
    assert (skin.master.awaited, skin.master.passed) == ([1, 2], False)
    skin.run(0.2, beating=False)
    assert (skin.master.awaited, skin.master.passed) == ([1], False)
    skin.run(0.2, beating=False)
    assert (skin.master.awaited, skin.master.passed) == ([1], True)


# Errands


def errand() -> Generator[Transfer, bytes, bytes]:
    return (yield Read(0x2035))


def test_a_node_has_one_errand_at_a_time(skin: Boards) -> None:
    skin.mute.add(1)
    first = skin.master.ask(1, errand(), skin.now_s)
    assert first is skin.node(1).errand
    assert first is not None
    assert not first.done
    assert skin.master.ask(1, errand(), skin.now_s) is None
    assert skin.master.ask(2, errand(), skin.now_s) is not None
    skin.run(0.29)
    assert skin.node(1).errand is first
    skin.run(0.03)
    assert skin.node(1).errand is None
    assert isinstance(first.error, SdoTimeoutError)
    assert skin.trusted() == [1, 2]


def test_an_answer_ends_an_errand(skin: Boards) -> None:
    found = skin.master.ask(1, errand(), skin.now_s)
    assert found is not None
    skin.hear(ANSWER + 1, bytes.fromhex("43352000010203"))  # seven bytes
    assert not found.done
    skin.hear(ANSWER + 1, bytes.fromhex("4335200001020304"))
    assert (found.result, skin.node(1).errand) == (b"\1\2\3\4", None)


def test_no_errand_begins_with_a_node_that_is_doubted_proven_or_in_use_by_others(skin: Boards) -> None:
    free_s = skin.now_s + 0.05
    skin.hear(REQUEST + 1, request(0x40, 0x1000))
    assert skin.master.ask(1, errand(), skin.now_s) is None
    assert skin.master.ask(1, errand(), free_s - 0.001) is None
    assert skin.master.ask(1, errand(), free_s) is not None
    skin.beat(1, BOOTED)
    assert skin.node(1).errand is None
    assert skin.master.ask(1, errand(), skin.now_s + 0.06) is None
    skin.mute.add(2)
    while skin.node(2).dialogue is None:
        skin.run(0.01)
    assert skin.master.ask(2, errand(), skin.now_s) is None


def test_an_errand_gives_way_to_another_master(skin: Boards) -> None:
    skin.mute.add(1)
    skin.master.ask(1, errand(), skin.now_s)
    skin.hear(REQUEST + 1, request(0x40, 0x1000)[:7])
    assert skin.node(1).errand is not None
    skin.hear(REQUEST + 1, request(0x40, 0x1000))
    assert skin.node(1).errand is None
    assert skin.trusted() == [1, 2]


# Tries: one node that answers, boots and beats as the test says


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
        elif can_id == 0x601 and data[:4] in {b"\x40\x06\x20\0", b"\x40\x09\x20\0"}:
            if data[1] == od.CALIBRATION_SIGNATURE & 0xFF:  # the first question of a proof
                self.questions.append(round(self.now_s, 2))
            if self.answers:
                self._waiting.append(frame(0x581, b"\x43" + data[1:4] + self.signature.to_bytes(4, "little")))

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
