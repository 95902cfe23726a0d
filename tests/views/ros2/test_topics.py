"""What a message of the fabric becomes on ROS 2."""

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from canskin.calibration_messages import CalibrationState, CalibrationStatus
from health.state import ViewState
from skin.layout import Region, changed
from skin.taxel_places import Grid
from skin.wall_times import WallTimes
from tests import messages as make
from tests.health.helpers import Messages
from tests.layouts import tube_layout
from views.ros2.content import contact_cloud, contact_markers, header
from views.ros2.diagnostics import diagnostics
from views.ros2.topics import FORCE_IMAGE, HEAT_MAP, KEY, LABEL_TEXT, SKIN_WRENCH, TAXEL_CLOUD, Translator, topics_of


def test_an_image_without_readers_is_not_computed(messages: Messages, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    measured_n = Grid.measured_n
    monkeypatch.setattr(Grid, "measured_n", lambda *args: made.append(1) or measured_n(*args))
    translator = Translator(messages.layout, "palm", ViewState(messages.layout), wall=WallTimes(10**18))
    drafts = dict(translator.take(messages.image(1), 0.0))
    assert list(drafts) == [FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD, SKIN_WRENCH, KEY]
    assert made == []
    drafts[FORCE_IMAGE]()
    drafts[HEAT_MAP]()
    assert made == [1]


def test_a_label_has_a_stamp_and_its_cycle_beside_the_text(messages: Messages) -> None:
    translator = Translator(messages.layout, "palm", ViewState(messages.layout), wall=WallTimes(10**18))
    label = msgspec.structs.replace(messages.label("cup"), cycle=7, sampled_mono_ns=5, confidence=0.5)
    drafts = dict(translator.take(label, 0.0))
    assert drafts[LABEL_TEXT]().data == "cup"
    told = drafts[KEY]()
    assert (told.header.stamp.sec, told.header.stamp.nanosec) == (10**9, 5)
    values = {each.key: each.value for each in told.status[0].values}
    assert (told.status[0].name, values) == ("label", {"cycle": "7", "label": "cup", "confidence": "0.5"})
    unknown = Translator(messages.layout, "palm", ViewState(messages.layout))
    assert list(dict(unknown.take(label, 0.0))) == [LABEL_TEXT]  # no clock yet


def test_regions_have_wrenches_of_their_own_while_their_blocks_are_valid(messages: Messages) -> None:
    layout = changed(messages.layout, region=[Region(name="tip", box=(0, 0, 0, 0)), Region(name="all")])
    (tip,) = (each for each in topics_of(layout) if each.name == "wrench/tip")
    translator = Translator(layout, "palm", ViewState(layout), wall=WallTimes(10**18))
    of_tip = int(layout.phi().block_of_taxel[0])
    pixels = np.full((16, 16), 0.5, np.float32)
    for cycle, invalid, expected in ((1, of_tip, {}), (2, (of_tip + 1) % 8, {tip: 0.5})):
        drafts = dict(translator.take(messages.image(cycle, pixels=pixels, invalid=(invalid,)), 0.0))
        assert {each: drafts[each]().wrench.force.z for each in (tip, SKIN_WRENCH) if each in drafts} == expected


def test_a_skin_that_is_no_grid_is_points_without_images() -> None:
    messages = Messages(tube_layout())
    surface = messages.layout.taxels.surface
    translator = Translator(messages.layout, "tube", ViewState(messages.layout), wall=WallTimes(10**18))
    drafts = dict(translator.take(messages.image(1), 0.0))
    assert list(drafts) == [TAXEL_CLOUD, SKIN_WRENCH, KEY]
    cloud = drafts[TAXEL_CLOUD]()
    assert (cloud.height, cloud.width) == (1, 96)
    offsets = {each.name: each.offset // 4 for each in cloud.fields}
    floats = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(96, -1)
    np.testing.assert_allclose(floats[:, [offsets[name] for name in "xyz"]], surface.positions_m, atol=1e-8)
    normals = floats[:, [offsets[f"normal_{name}"] for name in "xyz"]]
    np.testing.assert_allclose(normals, surface.normals, atol=1e-6)


def test_a_contact_on_a_curved_skin_lies_on_it() -> None:
    taxels = tube_layout().taxels
    touch = make.contact(row=0.0, column=17.0, position_m=(0.0, 0.02, 0.01), normal=(0.0, 1.0, 0.0))
    _, disc, words = contact_markers(header(1, "tube"), taxels, [touch]).markers
    place, turn = disc.pose.position, disc.pose.orientation
    assert (place.x, place.y, place.z) == touch.position_m
    assert Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).apply((0, 0, 1)) == pytest.approx((0, 1, 0))
    assert words.pose.position.y == pytest.approx(0.02 + 4 * taxels.surface.pitch_m)
    cloud = contact_cloud(header(1, "tube"), taxels.surface, [touch], 0)
    assert np.frombuffer(cloud.data.tobytes(), "<f4")[:6] == pytest.approx((*touch.position_m, *touch.normal))


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
