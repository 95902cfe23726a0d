"""Since when a node is not whole, and why."""

import msgspec
import pytest

from canskin.messages import GatewayStatus
from health.nodes_why import LOSS_S
from health.state import ViewState
from tests.health.helpers import Messages, seen_of


@pytest.fixture
def state(messages: Messages) -> ViewState:
    return ViewState(messages.layout, 1000.0)


def troubles(state: ViewState, now_s: float, bus: int = 0) -> list[tuple[int, float, str]]:
    gateway = seen_of(state, now_s).gateway
    return [msgspec.structs.astuple(each) for each in gateway.buses[bus].nodes_why]


def losing(status: GatewayStatus, missing: list[int], emcy: int = 0) -> GatewayStatus:
    left = msgspec.structs.replace(status.buses[0], missing=missing, emcy=[0, emcy, 0, 0])
    buses = [left, *status.buses[1:]]
    return msgspec.structs.replace(status, buses=buses)


def test_a_node_tells_why_since_the_reason_began(state: ViewState, messages: Messages) -> None:
    right = (5, 5, 5, 5)
    for at_s, left in ((1.0, right), (2.0, (5, 255, 5, 127)), (3.0, (5, 255, 5, 0)), (4.0, right)):
        state.take(messages.gateway(nmt=(left, right)), at_s)
        assert troubles(state, at_s) == {
            1.0: [], 2.0: [(2, 1002.0, "silent"), (4, 1002.0, "pre-operational")],
            3.0: [(2, 1002.0, "silent"), (4, 1003.0, "booting")], 4.0: [],
        }[at_s]  # fmt: skip
        assert troubles(state, at_s, bus=1) == []


def test_refused_nodes_emergencies_and_dead_buses_are_told(state: ViewState, messages: Messages) -> None:
    status = messages.gateway(refused=(3,), links=("active", "lost"))
    buses = [msgspec.structs.replace(status.buses[0], emcy=[0, 0x8130, 0, 0]), status.buses[1]]
    state.take(msgspec.structs.replace(status, buses=buses), 1.0)
    assert [why for _, _, why in troubles(state, 1.0)] == ["EMCY 8130h", "refused by the gateway: not of this skin"]
    assert [why for _, _, why in troubles(state, 1.0, bus=1)] == ["its bus is down"] * 4


def test_a_node_loses_frames_until_none_is_missing_for_a_while(state: ViewState, messages: Messages) -> None:
    for at_s, missing in ((1.0, 7), (1.2, 7), (1.4, 8), (1.6, 8), (2.4, 9)):  # those of before are of before
        state.take(losing(messages.gateway(), [0, missing, 0, 0]), at_s)
        expected = [] if at_s < 1.3 else [(2, 1001.4, "frames with sums are missing")]
        assert troubles(state, at_s) == expected
    state.take(losing(messages.gateway(), [0, 9, 0, 0]), 2.4 + LOSS_S)
    assert troubles(state, 2.4 + LOSS_S) == []


def test_a_window_that_was_missed_explains_a_loss_and_is_none(state: ViewState, messages: Messages) -> None:
    for at_s, missing in ((1.0, 0), (1.2, 1), (1.2 + LOSS_S, 1)):
        state.take(losing(messages.gateway(), [0, missing, 0, 0], emcy=0xFF10), at_s)
        whys = [why for _, _, why in troubles(state, at_s)]
        assert whys == (["frames with sums are missing, EMCY FF10h"] if at_s == 1.2 else [])
