"""What services tell of themselves, in the snapshot, and notices of those that send nothing."""

import pytest

from canskin.messages import UNKNOWN_ERROR_NS
from canskin.peers import Peer
from health.notices import STARTED_S
from health.services import LOSS_S, PEERS, TOLD_S
from health.state import ViewState
from tests.health.helpers import Messages, note, seen_of
from tests.messages import service_status


def test_figures_are_of_the_last_second_and_of_all_services_of_a_name() -> None:
    state = ViewState(Messages().layout)
    for instance in ("1", "2"):
        state.take_peer(Peer("palm", "reconstructor", instance), True, 0.0)
    state.take(service_status(1), 1.0)
    alone = seen_of(state, 1.0).services["reconstructor"]
    assert (alone.memory_bytes, alone.processor_ratio, alone.made_per_s) == (1 << 20, None, None)
    state.take(service_status(1, instance="2", memory_bytes=0), 1.0)
    state.take(service_status(3), 2.0)  # by the clock of the service, not of its messages
    state.take(service_status(2, instance="2", memory_bytes=0), 2.0)
    both = seen_of(state, 2.0).services["reconstructor"]
    assert (both.memory_bytes, both.processor_ratio, both.made_per_s) == (1 << 20, 1.0, 200.0)
    late = seen_of(state, 2.0 + TOLD_S).services["reconstructor"]
    assert (late.memory_bytes, late.processor_ratio, late.made_per_s) == (None, None, None)


def test_a_service_that_loses_messages_is_named_while_it_does() -> None:
    state = ViewState(Messages().layout, epoch_s=100.0)
    note(state, "reconstructor", True, 0.0)
    instance = Peer("palm", "reconstructor", "1").instance
    for second, lost in enumerate((7, 7, 8, 9, 9)):  # the first are of before
        state.take(service_status(second, instance=instance, missed=lost - 3, overruns=3), float(second))
        named = [each for each in seen_of(state, float(second)).notices if each.code == "service-drops"]
        assert [(each.subject, each.since_time_s) for each in named] == [("reconstructor", 102.0)] * (second >= 2)
    assert "9 messages" in named[0].text
    assert "service-drops" not in {each.code for each in seen_of(state, 3.0 + LOSS_S).notices}


def test_a_clock_of_another_machine_that_is_known_badly_is_named() -> None:
    state = ViewState(Messages().layout)
    note(state, "reconstructor", True, 0.0)
    for second, error_ns, codes in ((1, UNKNOWN_ERROR_NS, []), (2, 4_000_000, []), (3, 6_000_000, ["clock-unsure"])):
        status = service_status(second, clock_offset_ns=10**12, clock_error_ns=error_ns)
        state.take(status, float(second))
        seen = seen_of(state, float(second))
        assert [each.code for each in seen.notices if each.code == "clock-unsure"] == codes
    service = seen.services["reconstructor"]
    assert (service.clock_offset_s, service.clock_error_s) == (pytest.approx(1e3), 0.006)


def test_a_clock_that_is_set_back_and_strangers_do_no_harm() -> None:
    state = ViewState(Messages().layout)
    note(state, "gateway", True, 0.0)
    for number in range(2 * PEERS):
        state.take(service_status(1, "gateway", f"{number}"), 1.0)
    assert seen_of(state, 1.0).services["gateway"].memory_bytes is None
    for second in (5, 3):
        state.take(service_status(second, "gateway"), 1.0)
    assert seen_of(state, 1.0).services["gateway"].made_per_s is None


def test_what_a_program_tells_itself_is_no_sign_of_the_hub() -> None:
    state = ViewState(Messages().layout)
    for is_there in (True, False):
        note(state, "viewer", is_there, 1.0)
    state.take(service_status(1, "viewer"), 1.1)
    assert seen_of(state, 1.1).cut_off


def told_at(state: ViewState, now_s: float) -> list[tuple[str, str]]:
    found = seen_of(state, now_s).notices
    return [(each.code, each.level) for each in found if each.subject == "reconstructor"]


def test_a_reconstructor_that_has_input_and_never_sent_an_image_is_silent() -> None:
    state = ViewState(Messages().layout)
    for name in ("gateway", "reconstructor"):
        note(state, name, True, 0.0)
    state.take(Messages().gateway(cycles=1000), 1.0)
    assert told_at(state, 1.0) == [("no-image", "info")]
    assert told_at(state, 2.0) == [("service-silent", "error")]


@pytest.mark.parametrize(
    ("runs_s", "told"), [(STARTED_S - 1, ("no-image", "info")), (STARTED_S, ("service-absent", "warning"))]
)
def test_no_reconstructor_is_a_warning_when_the_gateway_has_run_for_a_while(
    runs_s: float, told: tuple[str, str]
) -> None:
    state, status = ViewState(Messages().layout), Messages().gateway(cycles=1)
    note(state, "gateway", True, 0.0)
    state.take(Messages().gateway(cycles=round(runs_s * status.sync_rate_hz)), 2.0)
    assert told_at(state, 2.0) == [told]
