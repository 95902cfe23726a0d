"""Since when a node is not whole, and why."""

import msgspec
import pytest

from canskin.messages import SILENT, Fault, GatewayStatus, NmtState, NodeFault
from health.causes import GRAVE, Cause
from health.nodes_why import LOSS_S
from health.state import ViewState
from tests.health.helpers import Messages, seen_of


@pytest.fixture
def state(messages: Messages) -> ViewState:
    return ViewState(messages.layout, 1000.0)


def troubles(state: ViewState, now_s: float, bus: int = 0) -> list[tuple[int, float, str]]:
    gateway = seen_of(state, now_s).gateway
    return [msgspec.structs.astuple(each)[:3] for each in gateway.buses[bus].nodes_why]


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


def test_an_emergency_explains_a_loss(state: ViewState, messages: Messages) -> None:
    for at_s, missing in ((1.0, 0), (1.2, 1), (1.2 + LOSS_S, 1)):
        state.take(losing(messages.gateway(), [0, missing, 0, 0], emcy=0xFF10), at_s)
        whys = [why for _, _, why in troubles(state, at_s)]
        assert whys == ["frames with sums are missing, EMCY FF10h" if at_s == 1.2 else "EMCY FF10h"]


def changed_bus(status: GatewayStatus, **changed: object) -> GatewayStatus:
    return msgspec.structs.replace(
        status, buses=[msgspec.structs.replace(status.buses[0], **changed), *status.buses[1:]]
    )


def test_optional_boards_that_are_not_there_are_no_trouble_of_their_bus(state: ViewState, messages: Messages) -> None:
    for nodes in ([2], [1, 2]):  # also all boards of a bus
        away = {node: NodeFault(Fault.AWAY) for node in nodes}
        nmt = bytes(SILENT if node in nodes else NmtState.OPERATIONAL for node in (1, 2))
        state.take(changed_bus(messages.gateway(), faults=away, nmt=nmt, nodes=[1, 2]), 1.0)
        snapshot = seen_of(state, 1.0)
        assert snapshot.gateway.buses[0].level == "info"
        assert [each.level for each in snapshot.notices if each.code == "node-away"] == ["info"]


def test_the_evidence_of_a_node_does_not_repeat_what_is_wrong_and_an_optional_board_is_as_free_on_a_dead_bus(
    state: ViewState, messages: Messages
) -> None:
    faults = {1: NodeFault(Fault.SILENT, "silent: no heartbeat for 1.5 s"), 2: NodeFault(Fault.AWAY)}
    state.take(changed_bus(messages.gateway(), faults=faults, nmt=bytes([SILENT] * 2), nodes=[1, 2]), 1.0)
    told = {each.code: (each.level, each.text) for each in seen_of(state, 1.0).notices}
    assert told["node-silent"] == ("error", "left: node 1 silent (no heartbeat for 1.5 s)")
    assert told["node-away"] == ("info", "left: node 2 optional, not there")


@pytest.mark.parametrize("kind", Fault)
def test_each_fault_of_a_node_is_one_cause(state: ViewState, messages: Messages, kind: Fault) -> None:
    state.take(changed_bus(messages.gateway(), faults={2: NodeFault(kind, "what was seen")}), 1.0)
    (trouble,) = seen_of(state, 1.0).gateway.buses[0].nodes_why
    assert (trouble.node, trouble.code, trouble.why) == (2, f"node-{kind}", "what was seen")
    (notice,) = [each for each in seen_of(state, 1.0).notices if each.subject.startswith("left")]
    assert (notice.code, notice.since_time_s) == (trouble.code, 1001.0)
    assert notice.text.startswith("left: node 2 ")
    assert "(what was seen)" in notice.text


@pytest.mark.parametrize(
    ("told", "code"),
    [
        ({"answer_s": [(0.0, 0.0), (0.001, 0.28), (0.0, 0.0), (0.0, 0.0)]}, "node-late"),
        ({"heartbeat_s": [(0.9, 1.2), (0.9, 1.1), (0.9, 1.1), (0.9, 1.4)]}, "node-late"),
        ({"heartbeat_s": [(0.9, 1.2)] * 4, "answer_s": [(0.001, 0.2)] * 4}, None),
        ({"emcy": [0, 0x8130, 0, 0]}, "node-emergency"),
        ({"other_sync": "node 9 produces SYNC"}, "other-sync"),
        ({"load_ratio": 0.98}, "bus-full"),
        ({"load_ratio": 0.95}, None),
        ({"link": "passive", "trouble": "troubled"}, "error-passive"),
        ({"link": "bus_off", "trouble": "dead"}, "bus-off"),
        ({"link": "lost", "trouble": "dead"}, "interface-lost"),
        ({"trouble": "without SYNC"}, "sync-refused"),
    ],
)
def test_what_a_bus_tells_has_one_cause(
    state: ViewState, messages: Messages, told: dict[str, object], code: str | None
) -> None:
    status = msgspec.structs.replace(messages.gateway(), answer_limit_s=0.3, heartbeat_limit_s=1.5)
    state.take(changed_bus(status, **told), 1.0)
    codes = [each.code for each in seen_of(state, 1.0).notices if each.subject.startswith("left")]
    assert codes == ([] if code is None else [code])


@pytest.mark.parametrize(("kind", "word"), [(Fault.SILENT, "silent"), (Fault.ABSENT, "never heard")])
@pytest.mark.parametrize(
    ("silent", "place"),
    [((3, 4), "between node 2 and node 3"), ((1, 2, 3), "between node 3 and node 4"), ((2, 3), None), ((4,), None)],
)
def test_nodes_behind_a_place_that_fall_silent_together_are_a_broken_cable(
    state: ViewState, messages: Messages, silent: tuple[int, ...], place: str | None, kind: Fault, word: str
) -> None:
    state.take(messages.gateway(), 1.0)
    faults = {node: NodeFault(kind) for node in silent}
    state.take(changed_bus(messages.gateway(), faults=faults, out_s=dict.fromkeys(silent, 60.0)), 2.0)
    assert all(each.since_time_s == 942.0 for each in seen_of(state, 2.0).notices if each.subject.startswith("left"))
    found = [(each.code, each.subject) for each in seen_of(state, 2.0).notices if each.subject.startswith("left")]
    assert found == [("cable-break", f"left {place}") if place else (NodeFault(kind).code, f"left {word}")]


def test_sync_that_is_left_out_is_the_host_s_fault_for_a_while(state: ViewState, messages: Messages) -> None:
    for at_s, skipped in ((1.0, 3), (2.0, 5), (3.0, 6)):
        state.take(msgspec.structs.replace(messages.gateway(), syncs_skipped=skipped), at_s)
    told = [(each.text, each.since_time_s) for each in seen_of(state, 3.0).notices if each.code == "host-late"]
    assert told == [("the gateway's host is late: 6 SYNCs not sent", 1002.0)]
    state.take(msgspec.structs.replace(messages.gateway(), syncs_skipped=6), 3.0 + LOSS_S)
    assert "host-late" not in {each.code for each in seen_of(state, 3.0 + LOSS_S).notices}


def test_a_cause_is_found_by_its_code_and_says_what_to_do() -> None:
    for cause in Cause:
        assert Cause.of(cause.code) is cause
        notice = cause.notice("seen", "left")
        assert notice.mend
        assert "{" not in notice.mend
        assert cause.level in GRAVE
