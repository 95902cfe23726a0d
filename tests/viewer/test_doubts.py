"""Contacts that may be errors of the zero, and what the zero rests on."""

from typing import Any

import msgspec
import pytest

from canskin.calibration_messages import CalibrationState, CalibrationStatus
from tests.viewer.helpers import texts
from viewer.state import ViewState


@pytest.fixture
def state(messages: Any) -> ViewState:
    return ViewState(messages.layout)


def test_a_doubtful_contact_is_named_with_what_to_do(state: ViewState, messages: Any) -> None:
    found = messages.contacts()
    marked = msgspec.structs.replace(found.contacts[0], force_n=0.4321, doubtful_since_mono_ns=5_000_000_000)
    doubtful = msgspec.structs.replace(found, sampled_mono_ns=50_000_000_000, contacts=[marked])
    state.take_contacts(doubtful, 1.0)
    (text,) = texts(state, 1.1, "warning")
    assert text == (
        "a force of 0.432 N around row 8, column 6 has been in doubt for 45 s: a still weight, or an error of the zero,"
        " as of a warm patch; if nothing touches there: skin tare --region 2,0,13,11"
    )
    assert texts(state, 9.0, "warning") == []  # an old contact
    state.take_contacts(msgspec.structs.replace(doubtful, contacts=[marked] * 10), 9.0)
    assert len(texts(state, 9.1, "warning")) == 9
    assert "2 more contacts are in doubt" in texts(state, 9.1, "warning")
    state.take_contacts(found, 9.2)
    assert texts(state, 9.3, "warning") == []


def test_the_support_of_the_zero_is_shown(state: ViewState, messages: Any) -> None:
    known = CalibrationStatus(state=CalibrationState.FOLLOWING, zero_support=bytes([4, 4, 1]))
    for calibration, words in ((None, ""), (known, "2 measured, 1 stored")):
        state.take_gateway(msgspec.structs.replace(messages.gateway(), calibration=calibration), 1.0)
        gateway = state.snapshot(1.1)[0].gateway
        assert gateway is not None
        assert gateway.zero == words
