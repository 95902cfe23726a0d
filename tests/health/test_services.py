"""What services tell of themselves: notices of those that miss messages, and of those that send nothing."""

import pytest

from health.drops import DROPS_S
from health.notices import STARTED_S
from health.state import ViewState
from tests.health.helpers import Messages, note, seen_of
from tests.messages import service_status


@pytest.fixture
def state(messages: Messages) -> ViewState:
    state = ViewState(messages.layout, epoch_s=1000.0)
    for name in ("gateway", "reconstructor", "classifier"):
        note(state, name, True, 0.0)
    return state


def notices_at(state: ViewState, now_s: float, code: str) -> list[tuple[str, str, str, float | None]]:
    return [
        (each.subject, each.level, each.text, each.since_time_s)
        for each in seen_of(state, now_s).notices
        if each.code == code
    ]


def test_a_service_drops_from_its_first_new_loss_until_it_has_lost_nothing_for_a_while(state: ViewState) -> None:
    """What was lost before the first status is no news; two processes of a name count together."""
    for now_s, missed, overruns in ((1.0, 5, 0), (2.0, 5, 0)):
        state.take(service_status(missed=missed, overruns=overruns), now_s)
    assert not notices_at(state, 2.0, "service-drops")
    state.take(service_status(missed=7, overruns=1), 3.0)
    state.take(service_status(instance="2", missed=4), 3.0)
    state.take(service_status(instance="2", missed=5), 3.5)
    expected = [("reconstructor", "warning", "reconstructor misses messages: 4", 1003.0)]
    assert notices_at(state, 4.0, "service-drops") == expected
    assert notices_at(state, 3.4 + DROPS_S, "service-drops")[0][2].endswith(": 1")
    assert not notices_at(state, 3.5 + DROPS_S, "service-drops")


def test_a_reconstructor_that_has_input_and_never_sent_an_image_is_silent(state: ViewState, messages: Messages) -> None:
    state.take(messages.gateway(cycles=1000), 2.0)
    assert notices_at(state, 1.0, "no-image")
    ((subject, level, *_),) = notices_at(state, 2.0, "service-silent")
    assert (subject, level) == ("reconstructor", "error")
    assert not notices_at(state, 2.0, "no-image")


@pytest.mark.parametrize(("runs_s", "level"), [(STARTED_S - 1, "info"), (STARTED_S, "warning")])
def test_no_reconstructor_is_a_warning_when_the_gateway_has_run_for_a_while(
    runs_s: float, level: str, messages: Messages
) -> None:
    state = ViewState(messages.layout, epoch_s=1000.0)
    status = messages.gateway(cycles=1)
    state.take(messages.gateway(cycles=round(runs_s * status.sync_rate_hz)), 2.0)
    assert notices_at(state, 2.0, "no-image")[0][1] == level
