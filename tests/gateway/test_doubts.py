"""How long a node is believed: proofs in turn, writes of other masters, pauses; with boards that only answer SDO."""

from itertools import pairwise

import pytest

from dbc.canopen import (
    EMCY_BASE,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    NmtCommand,
    NmtState,
)
from dbc.contract import Contract
from dbc.indices import OD_GAIN, OD_TEST_PATTERN, OD_TPDO_MAPPING
from gateway.foreign_sdo import BLOCK_DOWNLOAD_S
from gateway.nmt_master import TICK_S, NmtMaster
from skin.layout import load_layout
from tests.gateway.helpers import Boards, request

#: The times that docs/bus.md promises.
PROOF_PERIOD_S = 2.0
PAUSES_S = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0)
LATER_S = 60.0
STABLE_S = 10.0
#: After its start for a heartbeat that was under way, and after an emergency for what it explains.
UNDER_WAY_S = 0.3
EXPLAINS_S = 2.0
#: After another master's SDO, before the gateway asks the same node.
SDO_QUIET_S = 0.05

TOO_SOON_S = 1e-6


@pytest.fixture
def boards(small: Contract) -> Boards:
    """Return nodes 1 and 2, proven."""
    built = Boards(small)
    built.run(0.5)
    assert built.trusted() == [1, 2]
    return built


def test_every_node_is_proven_once_a_round(boards: Boards) -> None:
    boards.asked_s.clear()
    boards.run(10 * PROOF_PERIOD_S)
    for times_s in boards.asked_s.values():
        assert len(times_s) in {10, 11}
        assert all(later - earlier == pytest.approx(PROOF_PERIOD_S, abs=0.05) for earlier, later in pairwise(times_s))
    assert boards.lines == []


def test_node_that_proves_nothing_any_more_is_believed_for_the_stated_time(boards: Boards) -> None:
    boards.mute.add(1)
    limit_s = boards.master.proof_limit_s
    proven_s = boards.master.nodes[1].proven_s
    boards.run(proven_s + limit_s - 2 * TICK_S - boards.now_s)
    assert boards.trusted() == [1, 2]
    boards.run(4 * TICK_S)
    assert boards.trusted() == [2]
    boards.run(0.3)
    assert boards.lines == ["node 1 on bus0 not proven for 5 s"]


def test_stated_time_is_4_9_s_for_32_nodes_at_1_mbit() -> None:
    contract = Contract.from_layout(load_layout())
    master = NmtMaster(contract, 0, lambda *_: None, lambda *_: None, lambda _: None)
    assert master.proof_limit_s == pytest.approx(4.9)


@pytest.mark.parametrize("command", [0x2F, 0x21, 0xC2], ids=["expedited", "in segments", "in blocks"])
@pytest.mark.parametrize("index", [OD_TPDO_MAPPING, OD_TEST_PATTERN])
def test_write_of_another_master_is_doubted_from_its_first_frame_on(boards: Boards, command: int, index: int) -> None:
    boards.hear(SDO_REQUEST_BASE + 1, request(command, index, 1))
    assert boards.trusted() == [2]
    boards.asked_s.clear()
    boards.run(SDO_QUIET_S + PAUSES_S[0] + 3 * TICK_S)
    assert boards.trusted() == [1, 2]


@pytest.mark.parametrize("command", [0x2F, 0x21, 0xC2], ids=["expedited", "in segments", "in blocks"])
def test_write_of_what_is_not_compared_is_not_doubted(boards: Boards, command: int) -> None:
    boards.hear(SDO_REQUEST_BASE + 1, request(command, OD_GAIN, 3))
    boards.run(0.02)
    boards.hear(SDO_REQUEST_BASE + 1, b"\x01" + bytes(7))  # its data
    assert boards.trusted() == [1, 2]


def test_data_of_a_block_download_to_what_is_not_compared_is_not_doubted(boards: Boards) -> None:
    boards.hear(SDO_REQUEST_BASE + 1, request(0xC2, OD_GAIN, 3))
    for number in range(1, 128):
        boards.hear(SDO_REQUEST_BASE + 1, bytes((number,)) + bytes(7))
    assert boards.trusted() == [1, 2]


def test_block_download_that_the_node_has_not_heard_hides_no_write(boards: Boards) -> None:
    """The first byte of a block's data may look like any command; but nobody knows whether this is a block's data."""
    boards.hear(SDO_REQUEST_BASE + 1, request(0xC2, OD_GAIN, 3))
    boards.run(BLOCK_DOWNLOAD_S / 2)
    boards.hear(SDO_REQUEST_BASE + 1, request(0x23, OD_TPDO_MAPPING, 1))
    assert boards.trusted() == [2]


def test_data_that_look_like_a_request_do_not_end_the_doubt_of_a_block_download(boards: Boards) -> None:
    boards.hear(SDO_REQUEST_BASE + 1, request(0xC2, OD_TPDO_MAPPING, 1))
    for _ in range(20):
        boards.hear(SDO_REQUEST_BASE + 1, request(0x23, OD_GAIN, 3))
        boards.run(SDO_QUIET_S / 2)
        boards.hear(SDO_REQUEST_BASE + 1, request(0x41, OD_GAIN, 3))
        boards.run(SDO_QUIET_S / 2)
        assert boards.trusted() == [2]


@pytest.mark.parametrize(
    ("base", "command"),
    [(SDO_RESPONSE_BASE, 0x80), (SDO_RESPONSE_BASE, 0xA1), (SDO_REQUEST_BASE, 0x80)],
    ids=["the node refuses", "the node confirms", "the master aborts"],
)
def test_block_download_that_has_ended_hides_no_write(boards: Boards, base: int, command: int) -> None:
    boards.hear(SDO_REQUEST_BASE + 1, request(0xC2, OD_GAIN, 3))
    boards.hear(base + 1, request(command, OD_GAIN, 3))
    boards.hear(SDO_REQUEST_BASE + 1, request(0x23, OD_TPDO_MAPPING, 1))
    assert boards.trusted() == [2]


def test_proof_gives_way_to_another_master_and_is_begun_again(boards: Boards) -> None:
    boards.mute.update({1, 2})
    boards.asked_s.clear()
    while not boards.asked_s:
        boards.run(TICK_S)
    (node_id,) = boards.asked_s
    boards.hear(SDO_REQUEST_BASE + node_id, request(0x40, 0x1000))
    boards.mute.clear()
    began_s = boards.now_s
    boards.run(SDO_QUIET_S - 2 * TICK_S)
    assert len(boards.asked_s[node_id]) == 1
    boards.run(PROOF_PERIOD_S)
    assert began_s + SDO_QUIET_S <= boards.asked_s[node_id][1] < began_s + PROOF_PERIOD_S
    assert boards.trusted() == [1, 2]


def test_refused_node_is_asked_again_after_a_minute(small: Contract) -> None:
    boards = Boards(small)
    boards.wrong.add(2)
    boards.run(0.5)
    assert (boards.trusted(), boards.master.refused) == ([1], [2])
    boards.wrong.clear()
    last_s = boards.asked_s[2][-1]
    boards.run(last_s + LATER_S - 2 * TICK_S - boards.now_s)
    assert boards.asked_s[2][-1] == last_s
    boards.run(4 * TICK_S)
    assert (boards.trusted(), boards.master.refused) == ([1, 2], [])


def test_refused_node_that_is_written_to_is_asked_again_at_once(small: Contract) -> None:
    boards = Boards(small)
    boards.wrong.add(2)
    boards.run(0.5)
    boards.wrong.clear()
    boards.hear(SDO_REQUEST_BASE + 2, request(0x23, OD_TPDO_MAPPING, 1))
    last_s = boards.asked_s[2][-1]
    boards.run(SDO_QUIET_S - 2 * TICK_S)
    assert boards.asked_s[2][-1] == last_s  # what the other master has begun may go on
    boards.run(4 * TICK_S)
    assert (boards.trusted(), boards.master.refused) == ([1, 2], [])


def test_pauses_before_the_tries_are_those_of_the_list(boards: Boards) -> None:
    """Node 1 leaves OPERATIONAL as soon as that is believed of it."""
    taken_s = []
    for _ in range(len(PAUSES_S)):
        boards.run(UNDER_WAY_S + 2 * TICK_S, beating=False)
        boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
        lost_s = boards.now_s
        assert boards.trusted() == [2]
        while boards.trusted() != [1, 2]:
            boards.run(TICK_S)
            assert boards.now_s < lost_s + max(PAUSES_S) + 1
        taken_s.append(boards.now_s - lost_s)
    assert taken_s == pytest.approx(PAUSES_S, abs=2.5 * TICK_S)
    boards.hear(HEARTBEAT_BASE + 2, b"\5")
    boards.run(STABLE_S + 0.1)
    boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    boards.run(PAUSES_S[0] + 3 * TICK_S, beating=False)
    assert boards.trusted() == [1, 2]


def test_heartbeat_from_before_the_start_is_no_news_for_a_short_while(boards: Boards) -> None:
    boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    boards.run(0.5, beating=False)
    assert boards.trusted() == [1, 2]
    trusted_s = boards.master.nodes[1].trusted_s
    boards.now_s = trusted_s + UNDER_WAY_S - TOO_SOON_S
    boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    assert boards.trusted() == [1, 2]
    boards.now_s = trusted_s + UNDER_WAY_S + TOO_SOON_S
    boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    assert boards.trusted() == [2]


@pytest.mark.parametrize(("ago_s", "words"), [(EXPLAINS_S - 0.01, " after EMCY 8130h"), (EXPLAINS_S + 0.01, "")])
def test_emergency_explains_what_follows_soon(boards: Boards, ago_s: float, words: str) -> None:
    boards.hear(EMCY_BASE + 1, bytes.fromhex("3081110000000000"))
    boards.now_s += ago_s
    boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    boards.run(0.3)
    assert boards.lines[0] == f"node 1 on bus0 left OPERATIONAL: pre-operational{words}"


def test_emergency_that_is_over_explains_nothing(boards: Boards) -> None:
    boards.hear(EMCY_BASE + 1, bytes.fromhex("3081110000000000"))
    boards.hear(EMCY_BASE + 1, bytes(8))
    boards.now_s += 0.5
    boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    boards.run(0.3)
    assert boards.lines[0] == "node 1 on bus0 left OPERATIONAL: pre-operational"


def test_node_that_was_given_up_is_tried_at_once_when_somebody_resets_it(boards: Boards) -> None:
    boards.mute.add(1)
    boards.now_s += 1.0
    boards.hear(HEARTBEAT_BASE + 1, bytes((NmtState.PRE_OPERATIONAL,)))
    boards.run(40.0)
    assert "node 1 on bus0 given up after 8 tries: tried again every 60 s" in boards.lines
    boards.mute.clear()
    boards.run(5.0)
    assert boards.trusted() == [2]
    boards.hear(NMT_COB_ID, bytes((NmtCommand.RESET_NODE, 1)))
    boards.hear(HEARTBEAT_BASE + 1, b"\0")
    boards.run(PAUSES_S[0] + 3 * TICK_S)
    assert boards.trusted() == [1, 2]
