"""What C boards do by time, and about errors, is what Python nodes do: heartbeats, emergencies, event-driven PDOs."""

import pytest

from bus.link import DISCARDED
from dbc.canopen import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID
from dbc.frame import ECHO
from tests.bus.harness import frame
from tests.nodes.firmware.twins import Twins, analogue, needs_compiler, small_contract

pytestmark = needs_compiler

#: No multiple of a heartbeat, an inhibit time or an event timer.
STEP_S = 0.007


@pytest.fixture(params=[small_contract, analogue])
def twins(request: pytest.FixtureRequest) -> Twins:
    """Return boards that have answered a SYNC."""
    made = Twins(request.param())
    made.put(NMT_COB_ID, b"\x01\x00")
    made.sync(1)
    made.answers()
    return made


def write(twins: Twins, index: int, subindex: int, value: int, size: int, node: int = 1) -> None:
    command = 0x23 | (4 - size) << 2
    data = bytes((command, index & 0xFF, index >> 8, subindex)) + value.to_bytes(4, "little")
    twins.put(SDO_REQUEST_BASE + node, data)
    (answer,) = twins.answers()
    assert answer[2][0] == 0x60


def identifiers(answers: list[tuple[int, int, bytes]]) -> list[int]:
    return [can_id for can_id, _, _ in answers]


def test_heartbeats_follow_1017h(twins: Twins) -> None:
    twins.go_on(3.0, STEP_S)
    assert identifiers(twins.answers()).count(HEARTBEAT_BASE + 1) == 3
    write(twins, 0x1017, 0, 100, 2)
    twins.go_on(1.0, STEP_S)
    assert 8 <= identifiers(twins.answers()).count(HEARTBEAT_BASE + 1) <= 10
    write(twins, 0x1017, 0, 0, 2)
    twins.go_on(1.5, STEP_S)
    assert HEARTBEAT_BASE + 1 not in identifiers(twins.answers())


def test_a_sync_of_a_wrong_length_is_reported_once_and_when_it_is_gone(twins: Twins) -> None:
    for data in (b"", b"", b"\x01", b"\x02"):
        twins.put(SYNC_COB_ID, data)
        twins.go_on(0.05, STEP_S)
    emergencies = [data for can_id, _, data in twins.answers() if can_id == 0x81]
    assert emergencies == [bytes.fromhex("0000004082000000"), bytes.fromhex("4082110000000000")]


def test_frames_that_were_given_up_are_counted_and_reported(twins: Twins) -> None:
    for port in (1, 1, 2):
        twins.put_all(frame(0x180 + port, bytes(8), DISCARDED, port=port))
    twins.go_on(0.05, STEP_S)
    assert [can_id for can_id in identifiers(twins.answers()) if can_id < 0x180] == [0x81, 0x82]
    twins.put(SDO_REQUEST_BASE + 1, bytes.fromhex("4020200300000000"))
    assert twins.answers() == [(0x581, 0, bytes.fromhex("4320200302000000"))]


@pytest.mark.parametrize("behaviour", [0, 1, 2])
def test_a_lost_heartbeat_is_reported_and_changes_the_state(twins: Twins, behaviour: int) -> None:
    write(twins, 0x1029, 1, behaviour, 1)
    write(twins, 0x1016, 1, 0x30 << 16 | 200, 4)
    twins.put(HEARTBEAT_BASE + 0x30, b"\x05")
    twins.go_on(0.5, STEP_S)
    lost = identifiers(twins.answers())
    assert (0x81 in lost) == (behaviour != 2)  # a stopped node sends no emergency
    twins.sync(1)
    assert (0x181 in identifiers(twins.answers())) == (behaviour == 1)
    twins.put(HEARTBEAT_BASE + 0x30, b"\x05", ECHO)
    twins.put(NMT_COB_ID, b"\x01\x01")
    twins.go_on(0.05, STEP_S)
    assert 0x81 in identifiers(twins.answers())


def test_an_emergency_goes_when_the_lost_node_is_watched_no_longer(twins: Twins) -> None:
    write(twins, 0x1029, 1, 1, 1)  # no change of state
    write(twins, 0x1016, 1, 0x30 << 16 | 200, 4)
    twins.put(HEARTBEAT_BASE + 0x30, b"\x05")
    twins.go_on(0.5, STEP_S)
    twins.answers()
    write(twins, 0x1016, 1, 0, 4)
    twins.go_on(2.0, STEP_S)
    emergencies = [data for can_id, _, data in twins.answers() if can_id == 0x81]
    assert emergencies == [bytes.fromhex("0000003081000000")]


def test_event_driven_pdos_keep_timer_and_inhibit_time(twins: Twins) -> None:
    for subindex, value, size in ((1, 0xC0000181, 4), (2, 254, 1), (3, 500, 2), (5, 200, 2), (1, 0x40000181, 4)):
        write(twins, 0x1800, subindex, value, size)
    twins.go_on(1.0, STEP_S)
    assert 4 <= identifiers(twins.answers()).count(0x181) <= 6
    twins.sync(2)  # new sums
    twins.go_on(0.15, STEP_S)
    assert 0x181 in identifiers(twins.answers())


def test_the_counter_decides_the_turn_also_where_it_does_not_divide_240() -> None:
    twins = Twins(small_contract())
    twins.answers()
    for subindex, value, size in ((1, 0xC0000181, 4), (2, 7, 1), (6, 5, 1), (1, 0x40000181, 4)):
        write(twins, 0x1800, subindex, value, size)
    twins.put(NMT_COB_ID, b"\x01\x00")
    answered = []
    for counter in range(1, 241):
        twins.sync(counter)
        answered += [data[0] for can_id, _, data in twins.answers() if can_id == 0x181]
    assert answered == [3, *range(5, 240, 7)]


def test_what_the_controllers_refuse_is_counted() -> None:
    twins = Twins(small_contract())
    twins.put(NMT_COB_ID, b"\x01\x00")
    for wire in twins.wires:
        wire.room = 3
    twins.sync(1)
    assert twins.c.frames_sent == twins.python.frames_sent == 3
    assert twins.c.frames_dropped == twins.python.frames_dropped == 1


def test_a_node_id_that_is_there_twice_is_told(twins: Twins) -> None:
    twins.put(HEARTBEAT_BASE + 1, b"\x05")
    assert twins.complaints == ["node-ID 1 is on bus0 twice"] * 2
