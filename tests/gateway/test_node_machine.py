"""One node at a time: a master, its clock, and boards that do nothing but answer SDO."""

from collections.abc import Callable, Generator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canskin.messages import SILENT
from dbc import indices as od
from dbc.canopen import (
    EMCY_BASE,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    NmtCommand,
    NmtState,
)
from dbc.configuration import TICK_S
from dbc.contract import Contract
from dbc.frame import ECHO
from gateway.batch import batch_of
from gateway.nmt_master import NmtMaster
from gateway.node_machine import NodeMachine, NodeState
from gateway.proof import PART
from gateway.sdo import Read, SdoTimeoutError, Transfer
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.gateway.boards import SdoServer
from tests.layouts import buses, small_contract
from tests.world import World

#: The times that docs/bus.md promises.
PROOF_PERIOD_S = 2.0
LATER_S = 60.0
#: After its start for a heartbeat that was under way, and after an emergency for what it explains.
UNDER_WAY_S = 0.3
EXPLAINS_S = 2.0
#: After another master's SDO, before the gateway asks the same node.
SDO_QUIET_S = 0.05

START, STOP, PRE_OPERATIONAL = NmtCommand.START, NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL
UPLOAD, DOWNLOAD = 0x40, 0x23


class Boards:
    """The boards of bus0, their master and its clock; every answer comes at once."""

    def __init__(self, contract: Contract) -> None:
        self.now_s = 100.0
        self.lines: list[str] = []
        self.servers = {node.node_id: SdoServer(contract, node) for node in contract.on_bus(0)}
        #: Times of questions by node-ID; node-IDs whose sums are used.
        self.asked_s: dict[int, list[float]] = {}
        self.used: set[int] = set()
        #: Boards that answer no SDO, whose configuration is wrong, that boot at each start.
        self.mute: set[int] = set()
        self.wrong: set[int] = set()
        self.boots: set[int] = set()
        self.beats = True
        self.states: dict[int, NmtState] = {}
        #: NMT commands of the gateway, with their times.
        self.commands: list[tuple[int, int]] = []
        self.commanded_s: list[float] = []
        self._waiting: list[tuple[int, bytes]] = []
        self._table = contract.table
        use = lambda node, used: self._use(node.node_id, used)  # noqa: E731
        self.master = NmtMaster(contract, 0, self._send, use, self.lines.append)
        self._beat_s = self.now_s

    def _use(self, node_id: int, used: bool) -> None:
        assert (node_id in self.used) != used
        self.used ^= {node_id}

    def _send(self, can_id: int, data: bytes) -> None:
        if can_id == NMT_COB_ID:
            command, node_id = data
            self.commands.append((command, node_id))
            self.commanded_s.append(self.now_s)
            self.states[node_id] = NmtState.OPERATIONAL if command == START else NmtState.PRE_OPERATIONAL
            self.hear(can_id, data, ECHO)
            if command == START and node_id in self.boots:
                self.states[node_id] = NmtState.PRE_OPERATIONAL
                self._waiting.append((HEARTBEAT_BASE + node_id, b"\0"))
            return
        node_id = can_id - SDO_REQUEST_BASE
        if data[0] & 0xE0 != 0x80:
            self.asked_s.setdefault(node_id, []).append(self.now_s)
            if node_id not in self.mute:
                answer = self.servers[node_id].answer(data)
                is_signature = int.from_bytes(data[1:3], "little") in {od.SIGNATURE, od.CALIBRATION_SIGNATURE}
                if node_id in self.wrong and is_signature:
                    answer = answer[:4] + b"\1\2\3\4"
                self._waiting.append((SDO_RESPONSE_BASE + node_id, answer))

    def hear(self, can_id: int, data: bytes, flags: int = 0, time_ns: int | None = None) -> None:
        time_ns = round(self.now_s * 1e9) if time_ns is None else time_ns
        self.master.take(batch_of(frame(can_id, data, flags, time_ns=time_ns), 0, self._table).talk, self.now_s)

    def beat(self, node_id: int, state: int) -> None:
        self.hear(HEARTBEAT_BASE + node_id, bytes((state,)))

    def request(self, node_id: int, command: int = UPLOAD, index: int = 0x1000, subindex: int = 0) -> None:
        """Let another master ask a node."""
        data = bytes((command,)) + index.to_bytes(2, "little") + bytes((subindex, 0, 0, 0, 0))
        self.hear(SDO_REQUEST_BASE + node_id, data)

    def run(self, seconds: float, step_s: float = TICK_S) -> None:
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            if self.beats and self.now_s >= self._beat_s:
                self._beat_s = self.now_s + 1.0
                for node_id, state in self.states.items():
                    self.beat(node_id, state)
            self.master.tick(self.now_s)
            while self._waiting:
                self.hear(*self._waiting.pop(0))

    def node(self, node_id: int) -> NodeMachine:
        return self.master.nodes[node_id]

    def lines_now(self) -> list[str]:
        """Return the lines since the last call, with those that wait for others."""
        self.master._lines.flush()
        lines = [*self.lines]
        self.lines.clear()
        return lines


@pytest.fixture
def skin(small: Contract) -> Boards:
    """Return nodes 1 and 2 of bus0, proven and running, 0.5 s after their start."""
    built = Boards(small)
    built.run(0.5)
    assert built.used == {1, 2}
    return built


def alone(*, wrong: bool = False) -> Boards:
    """Return the only node of a bus, in use or refused, whose proofs begin every 2 s."""
    built = Boards(small_contract(bus=buses(1, 1, blocks_per_node=2)))
    built.wrong = {1} if wrong else set()
    built.run(0.5)
    return built


# The table


def until_asked(boards: Boards) -> Boards:
    """Wait until a proof is open that nobody answers."""
    boards.mute = {1}
    while boards.node(1).dialogue is None:
        boards.run(TICK_S)
    return boards


def lost() -> Boards:
    boards = alone()
    boards.beat(1, NmtState.PRE_OPERATIONAL)
    return boards


def refused() -> Boards:
    boards = alone(wrong=True)
    boards.states[1] = NmtState.PRE_OPERATIONAL
    boards.beat(1, NmtState.PRE_OPERATIONAL)
    boards.run(0.1)
    return boards


def asked_again() -> Boards:
    boards = refused()
    boards.run(LATER_S - 1.0)
    return until_asked(boards)


W, C, R, RC, U, UC = NodeState
STATES: dict[NodeState, Callable[[], Boards]] = {
    W: lost,
    C: lambda: until_asked(lost()),
    R: refused,
    RC: asked_again,
    U: alone,
    UC: lambda: until_asked(alone()),
}


def silence(boards: Boards) -> None:
    boards.node(1).prove_at_s = float("inf")
    boards.now_s = boards.node(1).heard_s + 1.6
    boards.master.tick(boards.now_s)


def answer(boards: Boards, *, wrong: bool) -> None:
    """Let the board answer the next attempt."""
    boards.wrong, boards.mute = {1} if wrong else set(), set()
    boards.run(0.4)


def come_twice(boards: Boards) -> None:
    """Let frames come twice with other sums in two cycles."""
    for _ in range(2):
        boards.node(1).take_twice(boards.now_s)


#: What happens, and the state after it, by the state before it; other events of a state leave the state.
EVENTS: list[tuple[Callable[[Boards], None], dict[NodeState, NodeState]]] = [
    (lambda boards: boards.hear(HEARTBEAT_BASE + 1, b"\0"), dict.fromkeys(NodeState, W)),
    (lambda boards: boards.beat(1, NmtState.PRE_OPERATIONAL), {U: W, UC: C}),
    (lambda boards: boards.beat(1, NmtState.STOPPED), {U: W, UC: C}),
    (lambda boards: boards.hear(NMT_COB_ID, bytes((STOP, 1))), {U: W, UC: C}),
    (lambda boards: boards.hear(NMT_COB_ID, bytes((PRE_OPERATIONAL, 0))), {U: W, UC: C}),
    (lambda boards: boards.hear(NMT_COB_ID, bytes((STOP, 2))), {}),
    (lambda boards: boards.hear(NMT_COB_ID, bytes((START, 1))), {}),
    (lambda boards: boards.request(1, DOWNLOAD, od.TPDO_MAPPING, 1), {C: W, RC: R, U: W, UC: W}),
    (lambda boards: boards.request(1, DOWNLOAD, od.GAIN, 1), {C: W, RC: R, U: W, UC: W}),
    (lambda boards: boards.request(1, DOWNLOAD, od.EMCY_INHIBIT_100US), {C: W, RC: R, UC: U}),
    (lambda boards: boards.request(1), {C: W, RC: R, UC: U}),
    (silence, {R: W, RC: C, U: W, UC: C}),
    (lambda boards: answer(boards, wrong=False), {W: U, C: U, RC: U, UC: U}),
    (lambda boards: answer(boards, wrong=True), {W: R, C: R, RC: R, UC: R}),
    (come_twice, {C: W, U: W, UC: W}),
    (lambda boards: boards.run(1.0), {W: U, C: W, RC: R, UC: U}),
]


@pytest.mark.parametrize("state", NodeState)
@pytest.mark.parametrize("place", range(len(EVENTS)))
def test_what_happens_to_a_node_in_each_state(state: NodeState, place: int) -> None:
    boards = STATES[state]()
    assert boards.node(1).state is state
    boards.now_s += 0.4 if state in {U, UC} else 0.0  # its start is long ago
    happens, after = EVENTS[place]
    happens(boards)
    assert boards.node(1).state is after.get(state, state)
    assert boards.used == ({1} if boards.node(1).in_use else set())


@given(st.lists(st.tuples(st.integers(0, len(EVENTS) - 1), st.floats(0.0, 3.0)), max_size=12))
def test_whatever_has_happened_a_right_node_is_in_use_again_within_a_minute(told: list[tuple[int, float]]) -> None:
    boards = alone()
    for place, pause_s in told:
        EVENTS[place][0](boards)
        boards.run(pause_s)
        assert boards.used == ({1} if boards.node(1).in_use else set())
    boards.wrong, boards.mute = set(), set()
    boards.run(LATER_S + 2.0, 0.02)
    assert boards.used == {1}
    assert boards.commands[-1] == (START, 1)


# Proofs


def test_every_node_is_proven_once_a_round(skin: Boards) -> None:
    skin.asked_s.clear()
    skin.run(10 * PROOF_PERIOD_S)
    for times_s in skin.asked_s.values():
        assert len(times_s) in {10, 11}
        assert all(later - earlier == pytest.approx(PROOF_PERIOD_S, abs=0.05) for earlier, later in pairwise(times_s))
    assert skin.lines == []


def test_node_that_proves_nothing_any_more_is_believed_for_the_stated_time(skin: Boards) -> None:
    skin.mute.add(1)
    skin.run(skin.node(1).proven_s + skin.master.proof_limit_s - 2 * TICK_S - skin.now_s)
    assert skin.used == {1, 2}
    skin.run(4 * TICK_S)
    assert skin.used == {2}
    assert skin.lines_now() == ["node 1 on bus0 not proven for 5 s [node-unproven]"]
    default = NmtMaster(Contract.from_layout(load_layout()), 0, *[lambda *_: None] * 3)
    assert default.proof_limit_s == pytest.approx(4.9)


def test_a_proof_without_signature_costs_as_much_as_its_transfers_and_holds_from_its_oldest_read(
    small: Contract,
) -> None:
    skin = Boards(small)
    for index in (od.SIGNATURE, od.CALIBRATION_SIGNATURE):
        skin.servers[2].objects[index, 0] = bytes(4)
    skin.run(0.5)
    assert skin.used == {1, 2}
    # Every object, the signature that it has not, and some of its gains and offsets.
    transfers = len(skin.node(2).settings) + 1 + PART
    assert [skin.node(node_id).cost for node_id in (1, 2)] == [1, transfers]
    # Two rounds of 2 s for a proof of one transfer, and three attempts of 0.3 s.
    assert skin.master.proof_limit_s == pytest.approx(4.0 * (1 + transfers) / 2 + 0.9)
    skin.mute = {2}
    while skin.node(2).dialogue is None:
        skin.run(TICK_S)
    skin.run(0.2)
    skin.mute.clear()
    skin.run(0.5)
    assert skin.node(2).proven_s == skin.node(2).began_s < skin.asked_s[2][-1]


def test_a_proof_of_one_transfer_holds_from_the_question_that_was_answered() -> None:
    skin = STATES[UC]()
    skin.run(0.2)
    skin.mute.clear()
    skin.run(0.3)
    assert skin.node(1).proven_s == skin.asked_s[1][-1] > skin.node(1).began_s


def test_after_a_long_proof_the_bus_is_left_to_others_for_as_many_turns_as_it_had_transfers() -> None:
    skin = alone()
    skin.node(1).cost = 2
    skin.asked_s.clear()
    skin.run(11.0)
    pauses_s = [later - sooner for sooner, later in pairwise(skin.asked_s[1])]
    assert pauses_s == pytest.approx([4.0, 2.0, 2.0], abs=0.03)


def test_a_proof_gives_way_to_another_master_for_a_twentieth_of_a_second() -> None:
    skin = STATES[C]()
    skin.mute.clear()
    skin.asked_s.clear()
    for _ in range(3):
        skin.request(1)
        skin.run(SDO_QUIET_S - 2 * TICK_S)
        assert not skin.asked_s
    skin.run(4 * TICK_S)
    assert skin.used == {1}


def test_another_master_puts_a_proof_off_by_one_round_at_most() -> None:
    skin = alone()
    skin.asked_s.clear()
    for _ in range(220):
        skin.request(1)
        skin.run(0.04)
    proven_s = [100.01, *skin.asked_s[1], skin.now_s]
    assert all(later - sooner < 4.1 for sooner, later in pairwise(proven_s))
    assert proven_s[1] > 104.0  # it would have been 102.0
    assert skin.used == {1}


def test_nodes_are_awaited_until_they_are_proven_or_refused(small: Contract) -> None:
    skin = Boards(small)
    skin.mute, skin.wrong = {1}, {2}
    assert (skin.master.awaited, skin.master.passed) == ([1, 2], False)
    skin.run(0.2)
    assert (skin.master.awaited, skin.master.refused, skin.master.passed) == ([1], [2], False)
    skin.run(0.2)
    assert (skin.master.awaited, skin.master.passed) == ([1], True)


# Refusals


@pytest.mark.parametrize(("writes", "wait_s"), [(False, LATER_S), (True, SDO_QUIET_S)])
def test_a_refused_node_is_asked_again_after_a_minute_or_when_it_was_written_to(*, writes: bool, wait_s: float) -> None:
    skin = refused()
    assert (skin.used, skin.master.refused) == (set(), [1])
    skin.wrong.clear()
    last_s = skin.asked_s[1][-1]
    if writes:
        last_s = skin.now_s
        skin.request(1, DOWNLOAD, od.TPDO_MAPPING, 1)
    asked = len(skin.asked_s[1])
    skin.run(last_s + wait_s - 2 * TICK_S - skin.now_s)
    assert len(skin.asked_s[1]) == asked
    skin.run(4 * TICK_S)
    assert (skin.used, skin.master.refused) == ({1}, [])


def test_a_refusal_is_told_once_and_the_node_may_not_run(small: Contract) -> None:
    skin = Boards(small)
    skin.wrong.add(2)
    skin.run(0.1)
    skin.beat(2, NmtState.PRE_OPERATIONAL)
    skin.run(0.1)
    assert skin.commands == [(START, 1)]
    skin.beat(2, NmtState.OPERATIONAL)
    skin.run(62.0)
    assert skin.commands == [(START, 1), (PRE_OPERATIONAL, 2)]
    assert [line.split(":")[0] for line in skin.lines_now()] == ["node 2 on bus0 refused"]


# Losses


def test_heartbeat_from_before_the_start_is_no_news_for_a_short_while(skin: Boards) -> None:
    """Its heartbeat may have the old state until the start is on the bus, and shortly after it."""
    node = skin.node(1)
    skin.now_s = node.used_since_s + UNDER_WAY_S - 1e-6
    skin.beat(1, NmtState.PRE_OPERATIONAL)
    assert skin.used == {1, 2}
    node.started_ns = None
    skin.now_s += 0.1
    skin.hear(NMT_COB_ID, bytes((PRE_OPERATIONAL, 1)), ECHO, time_ns=0)
    skin.beat(1, NmtState.PRE_OPERATIONAL)
    assert skin.used == {1, 2}
    skin.hear(NMT_COB_ID, bytes((START, 1)), ECHO, time_ns=1_000_000_000)
    skin.hear(HEARTBEAT_BASE + 1, b"\x7f", time_ns=1_299_999_999)
    assert skin.used == {1, 2}
    skin.hear(HEARTBEAT_BASE + 1, b"\x7f", time_ns=1_300_000_000)
    assert skin.used == {2}


@pytest.mark.parametrize(
    ("told", "ago_s", "words"),
    [
        ([b"\x30\x81\x11"], EXPLAINS_S - 0.01, " after EMCY 8130h"),
        ([b"\x30\x81\x11"], EXPLAINS_S + 0.01, ""),
        ([b"\x30\x81\x11", b""], 0.5, ""),
    ],
)
def test_emergency_explains_what_follows_soon(skin: Boards, told: list[bytes], ago_s: float, words: str) -> None:
    for data in told:
        skin.hear(EMCY_BASE + 1, data.ljust(8, b"\0"))
    skin.now_s += ago_s
    skin.beat(1, NmtState.PRE_OPERATIONAL)
    assert skin.lines_now() == [f"node 1 on bus0 left OPERATIONAL: pre-operational{words} [node-left]"]


def test_emergencies_are_kept_with_their_codes(skin: Boards) -> None:
    for node_id, data in ((2, "3081110000000000"), (1, "10ff8100000000"), (9, "10ff810000000000")):
        skin.hear(EMCY_BASE + node_id, bytes.fromhex(data))  # that of node 1 is too short, node 9 is none of the skin
    assert (skin.master.emergencies, skin.master.emcy) == ([(2, 0x8130)], [0, 0x8130])
    skin.hear(EMCY_BASE + 2, bytes(8))
    assert (skin.master.emergencies, skin.master.emcy) == ([(2, 0x8130)], [0, 0])


def test_a_heartbeat_has_one_byte_and_its_highest_bit_is_no_part_of_the_state(small: Contract) -> None:
    skin = Boards(small)
    skin.hear(HEARTBEAT_BASE + 1, bytes((NmtState.OPERATIONAL, 0)))
    skin.hear(HEARTBEAT_BASE + 1, b"")
    skin.beat(9, NmtState.OPERATIONAL)
    skin.hear(NMT_COB_ID, bytes((STOP, 0)))  # tells nothing of a silent node
    assert skin.master.nmt.tolist() == [SILENT, SILENT]
    skin.beat(2, 0x80 | NmtState.OPERATIONAL)
    assert skin.master.nmt.tolist() == [SILENT, NmtState.OPERATIONAL]


def test_a_node_is_silent_a_second_and_a_half_after_its_heartbeat(skin: Boards) -> None:
    skin.beat(1, NmtState.OPERATIONAL)
    skin.now_s += 0.25
    skin.beat(2, NmtState.OPERATIONAL)
    skin.master.tick(skin.now_s + 1.249)
    assert skin.used == {1, 2}
    skin.master.tick(skin.now_s + 1.2601)
    assert skin.used == {2}
    assert skin.master.nmt.tolist() == [SILENT, NmtState.OPERATIONAL]
    assert "node 1 on bus0 silent: no heartbeat for 1.5 s [node-silent]" in skin.lines_now()


def test_a_stopped_node_is_commanded_to_pre_operational_before_it_is_asked(skin: Boards) -> None:
    skin.commands.clear()
    skin.now_s += 1.0
    skin.beat(1, NmtState.STOPPED)
    skin.beat(2, 6)
    skin.beats = False
    skin.run(0.2)
    assert skin.used == {1, 2}
    assert skin.commands[0] == (PRE_OPERATIONAL, 1)
    assert sorted(skin.commands[1:]) == [(START, 1), (START, 2)]
    assert skin.lines_now() == [
        "node 1 on bus0 left OPERATIONAL: stopped [node-left]",
        "node 2 on bus0 left OPERATIONAL: state 6 [node-left]",
        "nodes 1-2 on bus0 back after 0.1 s",
    ]


# Tries


def test_a_node_that_boots_after_each_start_gets_eight_pauses_and_then_a_try_a_minute() -> None:
    skin = alone()
    skin.commands.clear()
    skin.commanded_s.clear()
    skin.boots = {1}
    began_s = skin.now_s
    skin.hear(HEARTBEAT_BASE + 1, b"\0")
    skin.run(22)
    skin.run(121, 0.02)
    starts_s = [at_s - began_s for at_s, each in zip(skin.commanded_s, skin.commands, strict=True) if each[0] == START]
    pauses_s = [after - before for before, after in zip([0.0, *starts_s], starts_s, strict=False)]
    assert pauses_s == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 60.0, 60.0], abs=0.025)
    given_up = [line for line in skin.lines if "given up" in line]
    assert given_up == ["node 1 on bus0 given up after 8 tries: tried again every 60 s"]
    # Somebody works on the node: it is tried at once.
    skin.boots.clear()
    skin.hear(NMT_COB_ID, bytes((NmtCommand.RESET_NODE, 1)))
    skin.hear(HEARTBEAT_BASE + 1, b"\0")
    skin.run(0.13)
    assert skin.used == {1}


@pytest.mark.parametrize(("stable_s", "pause_s"), [(9.9, 0.2), (10.1, 0.1)])
def test_pauses_begin_anew_after_ten_seconds_in_operational(stable_s: float, pause_s: float) -> None:
    skin = alone()
    skin.hear(HEARTBEAT_BASE + 1, b"\0")
    skin.run(0.1 + stable_s)
    skin.hear(HEARTBEAT_BASE + 1, b"\0")
    skin.run(pause_s - 0.02)
    assert not skin.used
    skin.run(0.04)
    assert skin.used == {1}


def test_a_silent_node_is_told_to_answer_before_it_is_asked_again_and_tried_as_at_first_when_it_is_heard() -> None:
    """It may be STOPPED, and then answers no SDO."""
    skin = alone()
    skin.beat(1, NmtState.OPERATIONAL)
    skin.beats, skin.mute = False, {1}
    skin.run(1.55)
    assert not skin.used
    for each in (skin.asked_s, skin.commands, skin.commanded_s):
        each.clear()
    began_s = skin.now_s
    skin.run(1.5)
    # One attempt of 0.3 s each, after pauses of 0.1 s, 0.2 s, 0.4 s; the node was lost 0.04 s ago.
    assert [time_s - began_s for time_s in skin.asked_s[1]] == pytest.approx([0.06, 0.56, 1.26], abs=0.045)
    assert skin.commands == [(PRE_OPERATIONAL, 1)] * 2
    assert skin.commanded_s == skin.asked_s[1][1:]
    skin.run(5)
    for beat, soon_s in ((b"\0", 0.12), (b"\x7f", 0.02)):
        skin.node(1).nmt, skin.node(1).tries = SILENT, 4
        skin.hear(HEARTBEAT_BASE + 1, beat)
        skin.asked_s.clear()
        skin.run(soon_s)
        assert len(skin.asked_s[1]) == 1
        skin.run(1.2)
        # Three attempts of 0.3 s, and a pause of 0.2 s.
        times_s = [time_s - skin.asked_s[1][0] for time_s in skin.asked_s[1]]
        assert times_s == pytest.approx([0.0, 0.3, 0.6, 1.1], abs=0.05)
        skin.run(1.5)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (0x02, "left OPERATIONAL: stopped, by another master's NMT command [node-left]"),
        (0x80, "left OPERATIONAL: pre-operational, by another master's NMT command [node-left]"),
        (0x01, "booted again [node-booted]"),
        (0x81, "booted again, reset by another master [node-booted]"),
        (0x82, "booted again, reset by another master [node-booted]"),
        (0x07, "booted again [node-booted]"),
    ],
)
def test_commands_of_another_master(command: int, said: str) -> None:
    skin = alone()
    for data in ((command, 2), (command, 1, 0)):
        skin.hear(NMT_COB_ID, bytes(data))
    assert skin.used == {1}
    skin.hear(NMT_COB_ID, bytes((command, 1)))
    assert (skin.used == {1}) == said.startswith("booted")
    skin.hear(HEARTBEAT_BASE + 1, b"\0")
    assert skin.lines_now() == [f"node 1 on bus0 {said}"]


# Errands


def errand() -> Generator[Transfer, bytes, bytes]:
    return (yield Read(0x2035, 0, 0x08))


def test_a_node_has_one_errand_at_a_time(skin: Boards) -> None:
    skin.mute.add(1)
    first = skin.master.ask(1, errand(), skin.now_s)
    assert first is not None
    assert skin.master.ask(1, errand(), skin.now_s) is None
    assert skin.master.ask(2, errand(), skin.now_s) is not None
    skin.run(0.29)
    assert skin.node(1).errand is first
    skin.run(0.03)
    assert skin.node(1).errand is None
    assert isinstance(first.error, SdoTimeoutError)
    assert skin.used == {1, 2}
    found = skin.master.ask(1, errand(), skin.now_s)
    assert found is not None
    for data in ("43352000010203", "4335200001020304"):  # of seven bytes, and of eight
        assert not found.done
        skin.hear(SDO_RESPONSE_BASE + 1, bytes.fromhex(data))
    assert (found.result, skin.node(1).errand) == (b"\1\2\3\4", None)


def test_no_errand_begins_with_a_node_that_is_doubted_proven_or_in_use_by_others(skin: Boards) -> None:
    free_s = skin.now_s + SDO_QUIET_S
    skin.request(1)
    assert skin.master.ask(1, errand(), free_s - 0.001) is None
    assert skin.master.ask(1, errand(), free_s) is not None
    skin.request(1)  # it gives way
    assert skin.node(1).errand is None
    assert skin.used == {1, 2}
    skin.beat(1, NmtState.INITIALISING)
    assert skin.master.ask(1, errand(), skin.now_s + 0.06) is None
    skin.mute.add(2)
    while skin.node(2).dialogue is None:
        skin.run(0.01)
    assert skin.master.ask(2, errand(), skin.now_s) is None


def test_a_board_whose_answers_come_too_late_is_told_from_one_that_is_silent() -> None:
    world = World(small_contract())
    world.wires[0].line(SDO_RESPONSE_BASE + 1, 0x7FF).delay_ns = 900_000_000
    world.run(5.0)
    assert world.status().buses[0].faults[1].words.endswith("and an answer came after more than 0.3 s")
