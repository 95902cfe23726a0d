"""What a message of the fabric becomes on ROS 2."""

import msgspec
import numpy as np
import pytest

from canskin.calibration_messages import CalibrationState, CalibrationStatus
from health.state import ViewState
from skin.taxel_places import Grid
from skin.wall_times import WallTimes
from tests.health.helpers import Messages
from views.ros2.content import contact_markers, header
from views.ros2.diagnostics import diagnostics
from views.ros2.topics import FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD, Translator


def test_an_image_without_readers_is_not_computed(messages: Messages, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    measured_n = Grid.measured_n
    monkeypatch.setattr(Grid, "measured_n", lambda *args: made.append(1) or measured_n(*args))
    translator = Translator(messages.layout, "palm", ViewState(messages.layout), wall=WallTimes(10**18))
    drafts = dict(translator.take(messages.image(1), 0.0))
    assert list(drafts) == [FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD]
    assert made == []
    drafts[FORCE_IMAGE]()
    drafts[HEAT_MAP]()
    assert made == [1]


def test_diagnostics_tell_what_the_zero_rests_on_and_what_is_in_doubt(messages: Messages) -> None:
    state = ViewState(messages.layout)

    def told() -> dict[str, str]:
        skin = diagnostics(header(1, "palm"), state.snapshot(1.0)[0]).status[0]
        return {pair.key: pair.value for pair in skin.values}

    names = ("zero of the blocks", "oldest zero s", "doubtful taxels", "doubtful force N")
    assert [told()[name] for name in names] == ["unknown"] * 4
    calibration = CalibrationStatus(
        state=CalibrationState.FOLLOWING,
        zero_support=bytes([4] * 7 + [1]),
        zero_mono_ns=np.array([2_000_000_000] * 7 + [0], "<i8").tobytes(),
        doubtful_taxels=12,
        doubtful_force_n=0.5,
        told_mono_ns=5_000_000_000,
    )
    state.take(msgspec.structs.replace(messages.gateway(), calibration=calibration), 1.0)
    assert [told()[name] for name in names] == ["7 measured, 1 stored; oldest 3 s", "3.0", "12", "0.5"]


def test_the_force_of_a_doubtful_contact_has_a_question_mark(messages: Messages) -> None:
    contact = messages.contacts().contacts[0]
    marked = msgspec.structs.replace(contact, doubtful_since_mono_ns=5)
    made = contact_markers(header(1, "palm"), messages.layout.taxels, [contact, marked]).markers
    assert [each.text for each in made if each.text] == ["376.6 mN", "376.6 mN?"]
