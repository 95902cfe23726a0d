"""Tries and pauses before a node is in use again, its proofs, and the errands with a node in use."""

from collections.abc import Generator
from itertools import pairwise

import pytest

from dbc.contract import Contract
from gateway.sdo import Read, SdoTimeoutError, Transfer
from tests.gateway.helpers import (
    ANSWER,
    BOOTED,
    OPERATIONAL,
    PRE,
    PRE_OPERATIONAL,
    REQUEST,
    START,
    STOPPED,
    Listening,
    request,
    skin,
)
from tests.layouts import buses, small_contract

__all__ = ["skin"]


@pytest.mark.parametrize(("tries", "pause_s"), [(0, 0.1), (1, 0.2), (5, 3.2), (7, 5.0), (8, 60.0), (9, 60.0)])
def test_the_pause_grows_with_the_tries_and_giving_up_is_told_once(skin: Listening, tries: int, pause_s: float) -> None:
    skin.node(1).tries = tries
    skin.now_s += 1.0
    skin.beat(1, PRE)
    assert skin.node(1).prove_at_s == pytest.approx(skin.now_s + pause_s)
    given_up = ["node 1 on bus0 given up after 8 tries: tried again every 60 s"] if tries == 8 else []
    assert skin.lines_now() == ["node 1 on bus0 left OPERATIONAL: pre-operational", *given_up]


def test_a_silent_node_is_not_given_up_in_words(skin: Listening) -> None:
    skin.node(1).tries = 8
    skin.beat(2, OPERATIONAL)
    skin.node(1).heard_s = skin.now_s - 2
    skin.now_s += 0.02
    skin.master.tick(skin.now_s)
    assert skin.lines_now() == ["node 1 on bus0 silent: no heartbeat for 1.5 s"]


def test_tries_are_forgotten_after_ten_seconds_in_use(skin: Listening) -> None:
    node = skin.node(1)
    node.tries = 4
    node.trusted_s = node.proven_s = node.heard_s = skin.now_s
    skin.master.tick(skin.now_s + 1)
    assert node.tries == 4
    node.trusted_s = skin.now_s - 9.5
    skin.master.tick(skin.now_s + 1.02)
    assert node.tries == 0


def test_a_stopped_node_is_commanded_to_pre_operational_before_it_is_asked(skin: Listening) -> None:
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


def test_a_silent_node_is_commanded_to_pre_operational_from_its_second_try_on(small: Contract) -> None:
    """Its first is asked for without, once, and 0.2 s after that has failed the second begins."""
    skin = Listening(small)
    skin.mute.add(1)
    skin.run(0.4, beating=False)
    assert skin.commands == [(START, 2)]
    assert len(skin.asked_s[1]) == 2  # with the abort
    skin.run(0.2, beating=False)
    assert skin.commands == [(START, 2), (PRE_OPERATIONAL, 1)]
    assert skin.node(1).tries == 2


def test_a_refused_node_that_runs_is_stopped_from_running(small: Contract) -> None:
    skin = Listening(small)
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
    skin = Listening(small)
    skin.wrong.add(2)
    skin.run(62.0)
    assert len(skin.asked_s[2]) > 3
    assert [line.split(":")[0] for line in skin.lines] == ["node 2 on bus0 refused"]


# Proofs


def test_a_proof_without_signature_costs_as_much_as_its_transfers(small: Contract) -> None:
    skin = Listening(small)
    skin.plain.add(2)
    skin.run(0.5)
    assert skin.trusted() == [1, 2]
    transfers = len(skin.node(2).settings) + 1  # every object, and the signature that it has not
    assert [skin.node(node_id).cost for node_id in (1, 2)] == [1, transfers]
    # Two rounds of 2 s for a proof of one transfer, and three attempts of 0.3 s.
    assert skin.master.proof_limit_s == pytest.approx(4.0 * (1 + transfers) / 2 + 0.9)


def test_a_proof_holds_from_its_oldest_read(small: Contract) -> None:
    skin = Listening(small)
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


def alone() -> Listening:
    """Return the only node of a bus, proven, whose proofs begin every 2 s."""
    built = Listening(small_contract(bus=buses(1, 1, blocks_per_node=2)))
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


def test_the_first_proof_of_a_node_gives_way_to_another_master(small: Contract) -> None:
    skin = Listening(small)
    skin.mute.update({1, 2})
    skin.run(0.1, beating=False)
    assert skin.node(1).dialogue is not None
    free_s = skin.now_s + 0.05
    skin.hear(REQUEST + 1, request(0x40, 0x1000))
    assert skin.node(1).dialogue is None
    assert skin.node(1).prove_at_s == pytest.approx(free_s)
    assert skin.node(1).began_s == float("-inf")
    assert skin.node(2).dialogue is not None


def test_another_master_on_a_node_that_is_not_asked_changes_no_turn(skin: Listening) -> None:
    before = skin.node(1).began_s, skin.node(1).prove_at_s
    skin.node(1).proven_s = 1.0
    skin.hear(REQUEST + 1, request(0x40, 0x1000))
    assert (skin.node(1).began_s, skin.node(1).prove_at_s) == before


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
    skin = Listening(small)
    skin.mute.add(1)
    assert (skin.master.awaited, skin.master.passed) == ([1, 2], False)
    skin.run(0.2, beating=False)
    assert (skin.master.awaited, skin.master.passed) == ([1], False)
    skin.run(0.2, beating=False)
    assert (skin.master.awaited, skin.master.passed) == ([1], True)


# Errands


def errand() -> Generator[Transfer, bytes, bytes]:
    return (yield Read(0x2035))


def test_a_node_has_one_errand_at_a_time(skin: Listening) -> None:
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


def test_an_answer_ends_an_errand(skin: Listening) -> None:
    found = skin.master.ask(1, errand(), skin.now_s)
    assert found is not None
    skin.hear(ANSWER + 1, bytes.fromhex("43352000010203"))  # seven bytes
    assert not found.done
    skin.hear(ANSWER + 1, bytes.fromhex("4335200001020304"))
    assert (found.result, skin.node(1).errand) == (b"\1\2\3\4", None)


def test_a_boot_ends_the_open_dialogue(skin: Listening) -> None:
    skin.mute.add(1)
    while skin.node(1).dialogue is None:
        skin.run(0.01)
    skin.beat(1, BOOTED)
    assert skin.node(1).dialogue is None


def test_no_errand_begins_with_a_node_that_is_doubted_proven_or_in_use_by_others(skin: Listening) -> None:
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


def test_an_errand_gives_way_to_another_master(skin: Listening) -> None:
    skin.mute.add(1)
    skin.master.ask(1, errand(), skin.now_s)
    skin.hear(REQUEST + 1, request(0x40, 0x1000)[:7])
    assert skin.node(1).errand is not None
    skin.hear(REQUEST + 1, request(0x40, 0x1000))
    assert skin.node(1).errand is None
    assert skin.trusted() == [1, 2]
