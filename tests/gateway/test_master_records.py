"""What the master keeps of each node: starts and resets on the bus, heartbeats, emergencies."""

import pytest

from canskin.messages import SILENT
from dbc.canopen import NmtState
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR
from tests.gateway.helpers import (
    BOOTED,
    EMCY,
    HEARTBEAT,
    NMT,
    OPERATIONAL,
    PRE,
    PRE_OPERATIONAL,
    RESET_COMMUNICATION,
    RESET_NODE,
    START,
    STOP,
    STOPPED,
    Listening,
    skin,
)

__all__ = ["skin"]


def ns(now_s: float) -> int:
    return round(now_s * 1e9)


# Commands on the bus


def test_a_start_is_known_by_its_frame_on_the_bus(skin: Listening) -> None:
    assert sorted(skin.commands) == [(START, 1), (START, 2)]
    begun_ns = skin.node(1).started_ns
    assert begun_ns is not None
    skin.now_s += 1.0
    for data, flags in (
        (bytes((PRE_OPERATIONAL, 1)), ECHO),
        (bytes((START, 2)), ECHO),
        (bytes((START, 9)), ECHO),
        (bytes((START, 1)), ECHO | ERROR),
        (bytes((START, 1, 0)), ECHO),
        (bytes((START, 1)), 0),
    ):
        skin.hear(NMT, data, flags)
        assert skin.node(1).started_ns == begun_ns
    skin.hear(NMT, bytes((START, 1)), ECHO)
    assert skin.node(1).started_ns == ns(skin.now_s)


def test_a_start_that_waits_in_the_controller_excuses_old_heartbeats_for_a_second_and_a_half(skin: Listening) -> None:
    node = skin.node(1)
    node.started_ns = None
    for excused_s in (1.0, 1.499):
        skin.now_s = node.trusted_s + excused_s
        skin.beat(1, PRE)
        assert skin.trusted() == [1, 2]
    skin.now_s = node.trusted_s + 1.501
    skin.beat(1, PRE)
    assert skin.trusted() == [2]


def test_a_start_that_went_late_excuses_no_heartbeat_after_that(skin: Listening) -> None:
    skin.now_s = skin.node(1).trusted_s + 1.6
    skin.node(1).started_ns = ns(skin.now_s - 0.1)
    skin.beat(1, PRE)
    assert skin.trusted() == [2]


def test_commands_of_another_master_concern_the_nodes_that_they_name(skin: Listening) -> None:
    skin.hear(NMT, bytes((PRE_OPERATIONAL, 9)))
    skin.hear(NMT, bytes((START, 0)))
    skin.hear(NMT, bytes((STOP, 1, 0)))
    assert skin.trusted() == [1, 2]
    assert skin.master.nmt.tolist() == [OPERATIONAL, OPERATIONAL]
    skin.hear(NMT, bytes((STOP, 2)))
    assert skin.trusted() == [1]
    assert skin.master.nmt.tolist() == [OPERATIONAL, STOPPED]
    assert skin.lines_now() == ["node 2 on bus0 left OPERATIONAL: stopped, by another master's NMT command"]
    skin.hear(NMT, bytes((PRE_OPERATIONAL, 0)))
    assert skin.master.nmt.tolist() == [PRE, PRE]


def test_a_command_to_a_silent_node_tells_nothing_of_it(small: Contract) -> None:
    skin = Listening(small)
    skin.hear(NMT, bytes((STOP, 0)))
    assert skin.master.nmt.tolist() == [SILENT, SILENT]


@pytest.mark.parametrize("command", [RESET_NODE, RESET_COMMUNICATION])
def test_a_reset_by_another_master_is_the_reason_of_one_boot(skin: Listening, command: int) -> None:
    skin.hear(NMT, bytes((command, 0)))
    assert skin.trusted() == [1, 2]
    skin.beat(1, BOOTED)
    assert skin.lines_now() == ["node 1 on bus0 booted again, reset by another master"]
    skin.run(0.5)
    assert skin.trusted() == [1, 2]
    skin.beat(1, BOOTED)
    assert skin.lines_now()[-1] == "node 1 on bus0 booted again"


def test_a_reset_by_another_master_begins_the_tries_anew_once(skin: Listening) -> None:
    skin.mute.add(1)
    skin.node(1).tries = 5
    skin.hear(NMT, bytes((RESET_NODE, 1)))
    skin.beat(1, BOOTED)
    assert skin.node(1).tries == 0
    assert skin.node(1).prove_at_s == pytest.approx(skin.now_s + 0.1)
    skin.run(1.5)
    tries = skin.node(1).tries
    assert tries > 0
    skin.beat(1, BOOTED)
    assert skin.node(1).tries == tries


# Heartbeats


def test_a_heartbeat_has_one_byte_and_its_highest_bit_is_no_part_of_the_state(small: Contract) -> None:
    skin = Listening(small)
    skin.hear(HEARTBEAT + 1, bytes((OPERATIONAL, 0)))
    skin.hear(HEARTBEAT + 1, b"")
    skin.hear(HEARTBEAT + 9, bytes((OPERATIONAL,)))
    assert skin.master.nmt.tolist() == [SILENT, SILENT]
    skin.hear(HEARTBEAT + 2, bytes((0x80 | OPERATIONAL,)))
    assert skin.master.nmt.tolist() == [SILENT, OPERATIONAL]


def test_a_node_is_silent_a_second_and_a_half_after_its_heartbeat(skin: Listening) -> None:
    skin.beat(1, OPERATIONAL)
    skin.now_s += 0.25
    skin.beat(2, OPERATIONAL)
    skin.master.tick(skin.now_s + 1.249)
    assert skin.trusted() == [1, 2]
    skin.master.tick(skin.now_s + 1.2601)
    assert skin.trusted() == [2]
    assert skin.master.nmt.tolist() == [SILENT, OPERATIONAL]
    assert "node 1 on bus0 silent: no heartbeat for 1.5 s" in skin.lines_now()


def test_a_node_that_is_heard_again_is_asked_at_once(skin: Listening) -> None:
    node = skin.node(1)
    node.nmt, node.trusted, node.tries, node.prove_at_s = SILENT, False, 6, skin.now_s + 40
    skin.beat(1, PRE)
    assert (node.nmt, node.tries, node.prove_at_s) == (PRE, 0, skin.now_s)
    node.tries, node.prove_at_s = 6, skin.now_s + 40
    skin.beat(1, PRE)
    assert (node.tries, node.prove_at_s) == (6, skin.now_s + 40)
    node.nmt, node.prove_at_s = SILENT, skin.now_s - 1
    skin.beat(1, OPERATIONAL)
    assert node.prove_at_s == skin.now_s - 1


def test_a_silent_node_that_boots_begins_its_tries_anew(skin: Listening) -> None:
    node = skin.node(1)
    node.tries = 6
    skin.beat(1, BOOTED)
    assert (node.tries, node.nmt, node.heard_s) == (6, PRE, skin.now_s)
    node.nmt = SILENT
    skin.beat(1, BOOTED)
    assert node.tries == 0
    assert node.prove_at_s == pytest.approx(skin.now_s + 0.1)


def test_a_node_that_boots_for_the_first_time_is_asked_at_once(small: Contract) -> None:
    skin = Listening(small)
    skin.node(2).prove_at_s = skin.now_s + 9
    skin.beat(2, BOOTED)
    assert skin.node(2).prove_at_s == skin.now_s
    assert skin.lines_now() == []


# What is told


def test_emergencies_are_kept_with_their_codes(skin: Listening) -> None:
    skin.hear(EMCY + 2, bytes.fromhex("3081110000000000"))
    skin.hear(EMCY + 1, bytes.fromhex("10ff8100000000"))  # seven bytes
    skin.hear(EMCY + 9, bytes.fromhex("10ff810000000000"))
    assert (skin.master.emergencies, skin.master.emcy) == ([(2, 0x8130)], [0, 0x8130])
    skin.hear(EMCY + 2, bytes(8))
    assert (skin.master.emergencies, skin.master.emcy) == ([(2, 0x8130)], [0, 0])


def test_swapped_phases_reset_the_communication_of_a_node_in_use(skin: Listening) -> None:
    skin.commands.clear()
    skin.master.swapped(2, skin.now_s)
    skin.master.swapped(2, skin.now_s)
    assert skin.commands == [(RESET_COMMUNICATION, 2)]
    assert skin.trusted() == [1]


def test_stop_commands_all_nodes_to_pre_operational_and_tells_what_waits(skin: Listening) -> None:
    skin.commands.clear()
    skin.master.swapped(1, skin.now_s)
    assert skin.lines == []
    skin.master.stop()
    assert skin.commands[-1] == (PRE_OPERATIONAL, 0)
    assert len(skin.lines) == 1


def test_a_loss_of_unknown_state_is_told_by_its_number(skin: Listening) -> None:
    skin.now_s += 1.0
    skin.beat(1, 6)
    assert skin.lines_now() == ["node 1 on bus0 left OPERATIONAL: state 6"]
    assert NmtState.OPERATIONAL == OPERATIONAL
