"""The model: how old each part of a snapshot is, from when on it is stale, and which services are silent."""

from typing import Any

import msgspec
import pytest

from canskin.peers import new_peer
from health.state import ViewState
from tests.health.helpers import note, seen_of

EPOCH_S = 1000.0


@pytest.fixture
def state(messages: Any) -> ViewState:
    return ViewState(messages.layout, EPOCH_S)


def test_everything_that_comes_tells_its_age(state: ViewState, messages: Any) -> None:
    state.take(messages.image(), 3.0)
    state.take(messages.contacts(), 3.125)
    state.take(messages.label(), 3.25)
    state.take(messages.truth(), 3.375)
    state.take(messages.gateway(), 3.5)
    state.take(messages.nodes(), 3.625)
    snapshot = seen_of(state, 4.0)
    parts = [snapshot.image, snapshot.contacts, snapshot.label, snapshot.truth, snapshot.gateway, *snapshot.nodes]
    assert [part.age_s for part in parts if part is not None] == [1.0, 0.875, 0.75, 1.0, 0.5, 0.375]
    assert snapshot.time_s == 1004.0


@pytest.mark.parametrize(("now_s", "stale"), [(1.5, False), (1.5625, True)])
def test_what_is_measured_is_stale_after_half_a_second(
    state: ViewState, messages: Any, now_s: float, *, stale: bool
) -> None:
    state.take(messages.image(), 1.0)
    state.take(messages.contacts(), 1.0)
    state.take(messages.label(), 1.0)
    state.take(messages.truth(), 1.0)
    snapshot = seen_of(state, now_s)
    parts = [snapshot.image, snapshot.contacts, snapshot.label, snapshot.truth]
    assert [part.stale for part in parts if part is not None] == [stale] * 4


@pytest.mark.parametrize(("now_s", "stale"), [(2.5, False), (2.5625, True)])
def test_counters_are_stale_after_a_second_and_a_half(
    state: ViewState, messages: Any, now_s: float, *, stale: bool
) -> None:
    state.take(messages.gateway(), 1.0)
    state.take(messages.nodes(), 1.0)
    snapshot = seen_of(state, now_s)
    assert snapshot.gateway is not None
    assert [snapshot.gateway.stale, snapshot.nodes[0].stale] == [stale, stale]


# Figures


def test_latency_is_that_of_five_seconds_of_images(state: ViewState, messages: Any) -> None:
    for cycle, (now_s, latency_s) in enumerate([(1.0, 0.5), (2.0, 0.25), (3.0, 0.125)], 1):
        state.take(messages.image(cycle, sync_s=float(cycle), latency_s=latency_s), now_s)
    for now_s, middle_s, most_s in ((4.0, 0.25, 0.495), (6.5, 0.1875, 0.24875), (7.5, 0.125, 0.125)):
        figures = seen_of(state, now_s).figures
        assert figures.latency_p50_s == pytest.approx(middle_s)
        assert figures.latency_p99_s == pytest.approx(most_s)
    figures = seen_of(state, 9.0).figures
    assert (figures.latency_p50_s, figures.latency_p99_s) == (None, None)


def test_figures_of_the_newest_second(state: ViewState, messages: Any) -> None:
    state.take(messages.image(1, sync_s=1.0, invalid=(0, 1, 2)), 1.0)
    state.take(messages.image(2, sync_s=1.5, invalid=(0,)), 1.5)
    assert seen_of(state, 1.75).figures.valid_blocks_low == 5
    figures = seen_of(state, 2.25).figures
    assert (figures.valid_blocks, figures.valid_blocks_low) == (7, 7)
    figures = seen_of(state, 2.75).figures
    assert (figures.valid_blocks, figures.valid_blocks_low) == (7, None)
    assert (figures.psnr_image_db, figures.sensor_adds_noise) == (None, None)


# Services


def silent(state: ViewState, now_s: float) -> list[str]:
    return [name for name, service in seen_of(state, now_s).services.items() if service.silent]


def started(state: ViewState, messages: Any, *names: str) -> None:
    for name in names:
        state.take_peer(new_peer("palm", name, messages.layout.phi().fingerprint), True, 0.0)


@pytest.mark.parametrize(("cycles", "names"), [(150, []), (151, ["reconstructor"])])
def test_input_counts_after_a_second_and_a_half_of_cycles(
    state: ViewState, messages: Any, cycles: int, names: list[str]
) -> None:
    """At 100 Hz."""
    started(state, messages, "reconstructor")
    state.take(messages.gateway(cycles=cycles), 5.0)
    assert silent(state, 5.0) == names


def test_a_service_has_a_second_and_a_half_to_begin(state: ViewState, messages: Any) -> None:
    state.take(messages.gateway(cycles=1000), 4.0)
    state.take_peer(new_peer("palm", "classifier", messages.layout.phi().fingerprint), True, 3.0)
    assert silent(state, 4.4375) == []
    assert silent(state, 4.5) == ["classifier"]


def test_a_service_is_silent_after_half_a_second_without_messages(state: ViewState, messages: Any) -> None:
    started(state, messages, "classifier")
    state.take(messages.gateway(cycles=1000), 5.0)
    state.take(messages.label(), 5.0)
    assert silent(state, 5.5) == []
    assert silent(state, 5.5625) == ["classifier"]


@pytest.mark.parametrize(("gone_s", "stale"), [(0.75, False), (1.0, True), (1.25, True)])
def test_a_message_is_stale_when_its_sender_left_with_it_or_after_it(
    state: ViewState, messages: Any, gone_s: float, *, stale: bool
) -> None:
    note(state, "classifier", True, 0.5)
    state.take(messages.label(), 1.0)
    note(state, "classifier", False, gone_s)
    label = seen_of(state, 1.25).label
    assert label.stale is stale


def test_a_silent_gateway_is_told_once_it_had_a_status(state: ViewState, messages: Any) -> None:
    started(state, messages, "gateway", "reconstructor")
    assert silent(state, 9.0) == []
    state.take(msgspec.structs.replace(messages.gateway(cycles=1000), sync_rate_hz=0.0), 9.5)
    assert silent(state, 9.5) == []  # the rate is not known yet
    state.take(messages.gateway(cycles=1000), 10.0)
    assert silent(state, 11.5625) == ["gateway"]


def test_a_service_keeps_the_time_since_when_it_is_there(state: ViewState) -> None:
    for alive, now_s in ((True, 1.0), (True, 2.0), (False, 3.0), (False, 4.0)):
        note(state, "recorder", alive, now_s)
        since_s = seen_of(state, 5.0).services["recorder"].since_time_s
        assert since_s == EPOCH_S + (1.0 if alive else 3.0)


@pytest.mark.parametrize(("at_s", "now_s", "cut_off"), [(2.0, 2.0, True), (2.0625, 2.5, False), (2.0625, 2.5626, True)])
def test_the_hub_is_out_of_reach_without_a_message_after_the_own_token_went(
    state: ViewState, messages: Any, at_s: float, now_s: float, *, cut_off: bool
) -> None:
    note(state, "viewer", True, 1.0)
    note(state, "viewer", False, 2.0)
    state.take(messages.label(), at_s)
    assert seen_of(state, now_s).cut_off is cut_off
