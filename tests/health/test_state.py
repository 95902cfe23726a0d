"""The model: what is fresh, what is stale, what is counted."""

from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.calibration_messages import CalibrationState, CalibrationStatus
from canskin.peers import Peer, new_peer
from health.services import PEERS, SERVICES
from health.state import MISFITS_S, PROCESSES, ViewState
from tests import messages as make
from tests.health.helpers import note, seen_of
from tests.layouts import tube_layout

EPOCH_S = 1000.0


@pytest.fixture
def state(messages: Any) -> ViewState:
    return ViewState(messages.layout, EPOCH_S)


def texts(state: ViewState, now_s: float, level: str = "error") -> list[str]:
    return [notice.text for notice in seen_of(state, now_s).notices if notice.level == level]


def test_nothing_is_shown_before_anything_came(state: ViewState) -> None:
    snapshot, pictures = state.snapshot(0.0)
    assert (snapshot.image, snapshot.truth, snapshot.label, snapshot.gateway) == (None, None, None, None)
    assert (pictures.image, pictures.true, pictures.sensor) == (None, None, None)
    assert texts(state, 0.0, "info") == ["waiting for the gateway", "waiting for the first image"]


def test_reconstructor_that_leaves_makes_the_image_stale_at_once(state: ViewState, messages: Any) -> None:
    note(state, "gateway", True, 0.0)
    note(state, "reconstructor", True, 0.0)
    state.take(messages.image(), 1.0)
    note(state, "reconstructor", False, 1.1)
    snapshot = seen_of(state, 1.2)
    assert snapshot.image.stale
    (notice,) = [notice for notice in snapshot.notices if notice.level == "error"]
    assert notice.text == "images stopped: reconstructor is gone"
    assert notice.since_time_s == pytest.approx(EPOCH_S + 1.0)
    note(state, "reconstructor", True, 2.0)
    state.take(messages.image(), 2.1)
    assert texts(state, 2.2) == []


@pytest.mark.parametrize(
    ("gateway", "reconstructor", "expected"),
    [
        (True, True, "images stopped: reconstructor is there but sends none"),
        (False, True, "images stopped: no measurements without the gateway"),
        (True, False, "images stopped: reconstructor is gone"),
    ],
)
def test_notice_names_who_keeps_images_from_coming(
    state: ViewState, messages: Any, gateway: bool, reconstructor: bool, expected: str
) -> None:
    for name, alive in (("gateway", gateway), ("reconstructor", reconstructor)):
        note(state, name, True, 0.0)
        note(state, name, alive, 1.0)
    state.take(messages.image(), 0.5)
    assert expected in texts(state, 2.0)


def test_gateway_that_leaves_or_falls_silent_is_told(state: ViewState, messages: Any) -> None:
    note(state, "gateway", True, 0.0)
    state.take(messages.gateway(), 1.0)
    assert texts(state, 1.2) == []
    assert texts(state, 3.0) == ["the state of the buses is unknown: gateway sends no status"]
    note(state, "gateway", False, 3.5)
    snapshot = seen_of(state, 4.0)
    assert snapshot.gateway.stale
    assert texts(state, 4.0) == ["measurements stopped: gateway is gone"]


def test_classifier_that_leaves_or_falls_silent_is_told(state: ViewState, messages: Any) -> None:
    note(state, "classifier", True, 0.0)
    state.take(messages.label(), 1.0)
    state.take(messages.gateway(), 2.0)
    snapshot = seen_of(state, 2.0)
    assert snapshot.label.stale
    assert texts(state, 2.0) == ["labels stopped: classifier is there but sends none"]
    note(state, "classifier", False, 2.1)
    assert texts(state, 2.2) == ["labels stopped: classifier is gone"]


def test_virtual_nodes_that_leave_are_told(state: ViewState) -> None:
    for name in ("nodes", "nodes-2", "demo"):
        note(state, name, True, 0.0)
        note(state, name, False, 1.0)
    assert texts(state, 1.0) == [
        "no sums from the virtual nodes: the process is gone",
        "no sums from the virtual nodes-2: the process is gone",
    ]


def test_nodes_off_duty_are_named(state: ViewState, messages: Any) -> None:
    state.take(messages.gateway(nmt=((5, 255, 127, 255), (4, 4, 4, 4))), 1.0)
    assert texts(state, 1.1, "warning") == ["left: nodes 2, 4 silent", "left: node 3 pre-operational"]
    assert texts(state, 1.1) == ["right: all nodes stopped"]
    state.take(messages.gateway(nmt=((5, 255, 5, 5), (5, 255, 5, 5))), 1.2)
    assert texts(state, 1.3, "warning") == ["left, right: node 2 silent"]


def test_a_bus_without_any_operational_node_is_an_error_once_sync_runs(state: ViewState, messages: Any) -> None:
    gone = ((255, 4, 127, 255), (5, 5, 5, 5))
    found = ["left: node 3 pre-operational", "left: node 2 stopped", "left: nodes 1, 4 silent"]
    state.take(messages.gateway(cycles=0, nmt=gone), 1.0)
    assert texts(state, 1.1) == []
    assert "gateway is booting the nodes; SYNC has not started" in texts(state, 1.1, "info")
    assert sorted(texts(state, 1.1, "warning")) == sorted(found)
    state.take(messages.gateway(cycles=1, nmt=gone), 1.2)
    assert sorted(texts(state, 1.3)) == sorted(found)
    gateway = seen_of(state, 1.3).gateway
    assert [bus.level for bus in gateway.buses] == ["error", "info"]


def test_invalid_blocks_are_listed_and_counted(state: ViewState, messages: Any) -> None:
    state.take(messages.image(1, invalid=(0, 5, 6)), 1.0)
    state.take(messages.image(2, invalid=(5,)), 1.1)
    snapshot = seen_of(state, 1.2)
    assert snapshot.image.invalid_blocks == [5]
    figures = snapshot.figures
    assert (figures.valid_blocks, figures.valid_blocks_low, figures.blocks) == (7, 5, 8)


UNFIT: list[tuple[str, dict[str, Any]]] = [
    ("image", {"pixels": b"\0" * 12}),
    ("image", {"pixels": np.full(256, np.nan, "<f4").tobytes()}),
    ("image", {"valid": b"\1" * 9}),
    ("image", {"doubtful": b"\0"}),
    *(("image", each) for each in ({"sampled_mono_ns": 2**62}, {"sampled_mono_ns": -1}, {"cycle": 2**63})),
    ("truth", {"sensor": b""}),
    ("label", {"confidence": float("nan")}),
    ("gateway", {"sync_rate_hz": float("inf")}),
]


@pytest.mark.parametrize(("kind", "change"), UNFIT)
def test_a_message_of_another_skin_is_counted_and_not_shown(
    state: ViewState, messages: Any, kind: str, change: dict[str, Any]
) -> None:
    right = getattr(messages, kind)()
    assert state.take(right, 1.0)
    assert not state.take(msgspec.structs.replace(right, **change), 1.1)
    snapshot = seen_of(state, 1.2, undecodable=2)
    assert snapshot.ignored == 3
    assert texts(state, 1.2, "warning")[0].startswith("1 messages ignored")
    assert seen_of(state, 1.2 + MISFITS_S, undecodable=2).ignored == 0
    shown = getattr(snapshot, kind)
    assert shown is None or shown.age_s == pytest.approx(0.2)


@pytest.mark.parametrize(
    "change",
    [
        *({"row": 16.0}, {"column": np.nan}, {"force_n": 1e39}, {"peak_n": np.nan}, {"position_m": (0.0, np.inf, 0.0)}),
        *({"normal": (0, 0, np.nan)}, {"identity": -1}, {"identity": 2**32}, {"taxels": -1}, {"invalid_taxels": 257}),
    ],
)
def test_contacts_beside_the_skin_and_without_numbers_are_not_shown(
    state: ViewState, messages: Any, change: dict[str, Any]
) -> None:
    assert state.take(messages.contacts(), 1.0)
    assert not state.take(messages.contacts(**change), 1.0)


def test_contacts_are_those_of_the_newest_image_and_age(state: ViewState, messages: Any) -> None:
    state.take(messages.contacts(3), 1.0)
    state.take(messages.contacts(4, blind=True), 1.1)
    shown = seen_of(state, 1.2).contacts
    assert (shown.cycle, shown.blind, shown.stale, [each.identity for each in shown.contacts]) == (4, True, False, [7])
    old = seen_of(state, 1.8).contacts
    assert old.stale


def test_the_process_of_nodes_silent_for_longest_makes_room(state: ViewState, messages: Any) -> None:
    for number in range(PROCESSES):
        state.take(messages.nodes(f"nodes-{number:03}"), 1.0)
    state.take(messages.nodes("nodes-000"), 2.0)
    state.take(messages.nodes("another"), 2.0)
    shown = {each.process for each in seen_of(state, 2.1).nodes}
    assert len(shown) == PROCESSES
    assert {"nodes-000", "another"} < shown
    assert "nodes-001" not in shown


def test_lost_hub_is_one_notice_and_blames_nobody_else(state: ViewState, messages: Any) -> None:
    for name in ("viewer", "gateway", "reconstructor", "nodes"):
        note(state, name, True, 0.0)
    state.take(messages.image(), 1.0)
    for name in ("viewer", "gateway", "reconstructor", "nodes"):
        note(state, name, False, 2.0)
    snapshot = seen_of(state, 3.0)
    assert [(notice.text, notice.since_time_s) for notice in snapshot.notices] == [
        ("nothing arrives: the fabric's hub, usually the gateway, is out of reach", EPOCH_S + 2.0)
    ]
    assert snapshot.image.stale


def test_lost_hub_does_not_hide_messages_that_were_ignored(state: ViewState, messages: Any) -> None:
    state.take(msgspec.structs.replace(messages.image(), valid=b""), 1.0)
    note(state, "viewer", True, 0.0)
    note(state, "viewer", False, 2.0)
    assert [notice.level for notice in seen_of(state, 3.0).notices] == ["error", "warning"]


@pytest.mark.parametrize(
    ("valid_sums", "blind", "measured"), [(0, False, False), (15, False, False), (16, False, True), (64, True, False)]
)
def test_label_of_too_few_sums_does_not_count(
    state: ViewState, messages: Any, valid_sums: int, *, blind: bool, measured: bool
) -> None:
    state.take(msgspec.structs.replace(messages.label("", valid_sums=valid_sums), blind=blind), 1.0)
    shown = seen_of(state, 1.1).label
    assert shown.measured is measured


def test_dead_buses_are_named_and_not_their_silent_nodes(state: ViewState, messages: Any) -> None:
    silent = (255, 255, 255, 255)
    lost, off, passive = "dead: no interface", "dead: bus-off", "troubled: passive"
    state.take(messages.gateway(nmt=(silent, silent), links=("lost", "lost"), troubles=(lost, lost)), 1.0)
    assert texts(state, 1.1) == [f"buses left, right {lost}"]
    assert texts(state, 1.1, "warning") == []
    state.take(messages.gateway(nmt=(silent, silent), links=("passive", "bus_off"), troubles=(passive, off)), 1.2)
    assert texts(state, 1.3) == [f"bus left {passive}", f"bus right {off}", "left: all nodes silent"]
    assert texts(state, 1.3, "warning") == []
    gateway = seen_of(state, 1.3).gateway
    assert [(bus.dead, bus.synced) for bus in gateway.buses] == [(False, False), (True, False)]
    state.take(messages.gateway(nmt=((5, 255, 255, 255), silent), links=("passive", "active")), 1.4)
    gateway = seen_of(state, 1.5).gateway
    assert [bus.synced for bus in gateway.buses] == [True, True]


def test_skin_of_which_nothing_is_measured_is_told(state: ViewState, messages: Any) -> None:
    state.take(messages.gateway(), 1.0)
    state.take(messages.image(invalid=tuple(range(8))), 1.0)
    assert texts(state, 1.1) == ["nothing is measured: no block sent its sums"]
    state.take(messages.image(2, invalid=tuple(range(7))), 1.1)
    assert texts(state, 1.2) == []


def test_refused_node_is_named_unless_it_left(state: ViewState, messages: Any) -> None:
    state.take(messages.gateway(nmt=((127, 127, 255, 5), (5, 5, 5, 5)), refused=(2, 3)), 1.0)
    assert texts(state, 1.1, "warning") == [
        "left: node 1 pre-operational",
        "left: node 2 refused by the gateway: not of this skin",
        "left: node 3 silent",
    ]


def test_services_do_not_pile_up(state: ViewState) -> None:
    note(state, "gateway", True, 0.0)
    for number in range(3 * SERVICES):
        note(state, f"service-{number}", True, number)
        note(state, f"service-{number}", False, number)
    services = seen_of(state, 1000.0).services
    assert len(services) == SERVICES
    assert services["gateway"].alive
    assert f"service-{3 * SERVICES - 1}" in services
    for number in range(3 * SERVICES):
        note(state, f"lasting-{number}", True, 2000.0)
    assert len(seen_of(state, 3000.0).services) == SERVICES


def test_other_skins_do_not_pile_up(state: ViewState) -> None:
    others = [new_peer(f"skin-{number:03}", "gateway", "0123456789abcdef") for number in range(PEERS + 10)]
    for peer in others:
        state.take_peer(peer, True, 0.0)
    assert seen_of(state, 0.1).other_skins == [peer.skin for peer in others[:PEERS]]
    state.take_peer(others[0], False, 1.0)
    assert others[0].skin not in seen_of(state, 1.1).other_skins


def test_service_of_another_phi_or_version_is_an_error_that_names_both(state: ViewState, messages: Any) -> None:
    own = messages.layout.phi().fingerprint
    state.take_peer(new_peer("palm", "gateway", own), True, 0.0)
    state.take_peer(new_peer("palm", "nodes", ""), True, 0.0)
    assert texts(state, 0.1) == []
    other = new_peer("palm", "reconstructor", "0123456789abcdef")
    state.take_peer(other, True, 1.0)
    (text,) = texts(state, 1.1)
    assert "reconstructor has Φ 0123456789abcdef, " in text
    assert own in text
    assert seen_of(state, 1.1).services["reconstructor"].fingerprint == "0123456789abcdef"
    right = new_peer("palm", "reconstructor", own)
    state.take_peer(right, True, 2.0)  # a second one, while the first is still there
    assert len(texts(state, 2.1)) == 1
    state.take_peer(other, False, 3.0)
    assert texts(state, 3.1) == []
    assert seen_of(state, 3.1).services["reconstructor"].alive
    state.take_peer(msgspec.structs.replace(right, version="9.9", instance="2"), True, 4.0)
    assert "reconstructor is canskin 9.9" in texts(state, 4.1)[0]


def test_another_skin_on_the_hub_is_named_while_there_is_no_gateway(state: ViewState, messages: Any) -> None:
    stranger = new_peer("hand", "gateway", "0123456789abcdef")
    state.take_peer(stranger, True, 1.0)
    state.take_peer(Peer("health", "health", "1"), True, 1.0)
    (text,) = texts(state, 1.1, "warning")
    assert "shows skin 'palm', and on its hub is 'hand'" in text
    assert "gateway" not in seen_of(state, 1.1).services
    state.take_peer(new_peer("palm", "gateway", messages.layout.phi().fingerprint), True, 2.0)
    assert texts(state, 2.1, "warning") == []


def test_a_skin_without_zero_and_its_defects_are_told(state: ViewState, messages: Any) -> None:
    found = CalibrationStatus(state=CalibrationState.TOUCHED, defects=[f"sum {each} is stuck" for each in range(10)])
    state.take(msgspec.structs.replace(messages.gateway(), calibration=found), 1.0)
    assert any("has touched the skin since the start" in text for text in texts(state, 1.0, "info"))
    told = texts(state, 1.0, "warning")
    assert "sum 7 is stuck" in told
    assert "sum 8 is stuck" not in told
    assert "2 more defects: skin calibration show" in told


def test_nodes_with_other_gains_are_named_until_somebody_accepts_it(state: ViewState, messages: Any) -> None:
    changed = [f"bus0 node {each}" for each in range(1, 11)]
    found = CalibrationStatus(state=CalibrationState.FOLLOWING, recalibrated=changed)
    state.take(msgspec.structs.replace(messages.gateway(), calibration=found), 1.0)
    (told,) = texts(state, 1.0, "warning")
    assert told.startswith("gains or offsets of bus0 node 1, ")
    assert "bus0 node 8 and 2 more have changed: forces there are doubtful until that is accepted" in told


def test_a_doubtful_contact_is_named_with_what_to_do(state: ViewState, messages: Any) -> None:
    found = messages.contacts()
    marked = msgspec.structs.replace(found.contacts[0], force_n=0.4321, doubtful_since_mono_ns=5_000_000_000)
    doubtful = msgspec.structs.replace(found, sampled_mono_ns=50_000_000_000, contacts=[marked])
    state.take(doubtful, 1.0)
    (notice,) = [each for each in seen_of(state, 1.1).notices if each.level == "warning"]
    assert notice.mend == "'skin tare --region 2,0,13,11' if nothing touches there"
    (text,) = texts(state, 1.1, "warning")
    assert text == (
        "a force of 0.432 N around row 8, column 6 has been in doubt for 45 s: a still weight, or an error of the zero,"
        " as of a warm patch; if nothing touches there: skin tare --region 2,0,13,11"
    )
    assert texts(state, 9.0, "warning") == []  # an old contact
    state.take(msgspec.structs.replace(doubtful, contacts=[marked] * 10), 9.0)
    assert len(texts(state, 9.1, "warning")) == 9
    assert "2 more contacts are in doubt" in texts(state, 9.1, "warning")
    state.take(msgspec.structs.replace(doubtful, sampled_mono_ns=14_000_000_000), 9.1)
    assert texts(state, 9.2, "warning") == []  # most forces move again
    state.take(found, 9.2)
    assert texts(state, 9.3, "warning") == []


def test_a_doubtful_contact_of_a_skin_that_is_no_grid_is_named_by_its_taxel() -> None:
    state = ViewState(tube_layout())
    box = {"top": 0, "bottom": 0, "left": 12, "right": 20}
    found = make.contacts(1, make.contact(row=0.0, column=17.0, doubtful_since_mono_ns=5, **box))
    state.take(msgspec.structs.replace(found, sampled_mono_ns=20_000_000_000), 1.0)
    (text,) = texts(state, 1.1, "warning")
    assert "N around taxel 17 has been in doubt" in text
    assert text.endswith("if nothing touches there: skin tare")


def test_the_support_of_the_zero_is_shown(state: ViewState, messages: Any) -> None:
    known = CalibrationStatus(state=CalibrationState.FOLLOWING, zero_support=bytes([4, 4, 1]))
    for calibration, words in ((None, ""), (known, "2 measured, 1 stored")):
        state.take(msgspec.structs.replace(messages.gateway(), calibration=calibration), 1.0)
        gateway = seen_of(state, 1.1).gateway
        assert gateway is not None
        assert gateway.zero == words
