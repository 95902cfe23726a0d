"""Frames are joined from messages that come in any order, or do not come."""

import itertools
import math

import msgspec
import numpy as np
import pytest

from canskin.description import Description
from canskin.errors import InputError
from canskin.frame import FrameBuilder
from tests.client.helpers import contacts, description, image, label, measurement

EVEN = np.arange(16).reshape(4, 4) % 2 == 0


@pytest.fixture
def builder() -> FrameBuilder:
    return FrameBuilder(description())


def test_a_frame_has_what_its_messages_have(builder: FrameBuilder) -> None:
    assert not builder.take(measurement(3))
    assert not builder.take(label(3))
    assert not builder.take(image(3))
    (frame,) = builder.take(contacts(3))
    assert np.array_equal(frame.image, np.arange(16, dtype=np.float32).reshape(4, 4))
    assert frame.image.dtype == np.float32
    assert frame.forces.tolist() == list(range(16))
    assert frame.valid.all()
    assert frame.sums.tolist() == [10, 20, 30, 40]
    assert frame.valid_sums.all()
    assert [each.force_n for each in frame.contacts] == [0.5]
    assert (frame.label, frame.confidence, frame.cycle, frame.is_blind) == ("cup", 0.9, 3, False)
    assert frame.sampled_mono_ns == 30_000_000
    assert frame.sampled_at == pytest.approx(7.03)
    assert frame.sampled_error_s == pytest.approx(2e-6)


def test_taxels_of_a_block_that_is_not_valid_are_nan_and_their_estimates_stay(builder: FrameBuilder) -> None:
    builder.take(measurement(1, valid=bytes((1, 0))))
    builder.take(image(1, valid=bytes((1, 0))))
    (frame,) = builder.take(contacts(1))
    assert np.array_equal(frame.valid, EVEN)
    assert np.array_equal(np.isnan(frame.image), ~EVEN)
    assert np.array_equal(frame.estimate.ravel(), np.arange(16))
    assert frame.valid_sums.tolist() == [True, True, False, False]


def test_masked_taxels_are_nan_and_their_estimates_stay() -> None:
    builder = FrameBuilder(msgspec.structs.replace(description(), masked=np.array([5, 6], "<u4").tobytes()))
    builder.take(image(1))
    (frame,) = builder.take(contacts(1))
    assert np.flatnonzero(np.isnan(frame.forces)).tolist() == np.flatnonzero(~frame.valid).tolist() == [5, 6]
    assert np.array_equal(frame.estimate.ravel(), np.arange(16))


def test_doubtful_taxels_and_contacts_are_told(builder: FrameBuilder) -> None:
    builder.take(image(1))
    (frame,) = builder.take(contacts(1))
    assert not frame.doubtful.any()
    assert frame.doubtful.shape == frame.image.shape
    assert not frame.contacts[0].doubtful
    builder.take(msgspec.structs.replace(image(2), doubtful=np.packbits(EVEN).tobytes()))
    found = contacts(2)
    marked = msgspec.structs.replace(found.contacts[0], doubtful_since_mono_ns=5)
    (frame,) = builder.take(msgspec.structs.replace(found, contacts=[marked]))
    np.testing.assert_array_equal(frame.doubtful, EVEN)
    assert (frame.contacts[0].doubtful, frame.contacts[0].doubtful_since_mono_ns) == (True, 5)
    builder.take(msgspec.structs.replace(image(3), doubtful=bytes(3)))
    assert not builder.take(contacts(3))
    assert builder.refused == 1


def test_offsets_are_taken_off_and_defective_sums_are_not_valid(builder: FrameBuilder) -> None:
    offsets = np.array((1, 2, 3, 4), "<i4").tobytes()
    builder.take(measurement(1, offsets=offsets, usable=bytes((1, 0, 1, 1))))
    builder.take(image(1))
    (frame,) = builder.take(contacts(1))
    assert frame.sums.tolist() == [9, 0, 27, 36]
    assert frame.valid_sums.tolist() == [True, False, True, True]


def test_messages_come_in_any_order(builder: FrameBuilder) -> None:
    for messages in itertools.permutations((measurement(1), label(1), image(1), contacts(1))):
        builder = FrameBuilder(description())
        frames = [frame for message in messages for frame in builder.take(message)]
        assert [len(frame.contacts) for frame in frames] == [1]
        assert not frames[0].is_blind


def test_contacts_of_a_lost_image_are_no_other_images(builder: FrameBuilder) -> None:
    builder.take(contacts(1))
    builder.take(image(2))
    assert [each.cycle for each in builder.take(contacts(2))] == [2]


def test_frames_of_another_layout_are_not_made(builder: FrameBuilder) -> None:
    builder.take(measurement(1, fingerprint="another"))
    assert builder.is_outdated
    builder.take(image(1))
    assert not builder.take(contacts(1))
    builder.take(measurement(2))
    builder.take(image(2))
    assert len(builder.take(contacts(2))) == 1


def test_an_image_without_contacts_comes_with_the_next_image(builder: FrameBuilder) -> None:
    builder.take(image(1))
    (frame,) = builder.take(image(2))
    assert (frame.cycle, frame.contacts, frame.is_blind) == (1, (), True)
    assert not builder.take(contacts(1))  # too late
    assert builder.take(contacts(2))[0].cycle == 2


def test_without_a_measurement_nothing_is_made_up(builder: FrameBuilder) -> None:
    builder.take(measurement(1))
    builder.take(image(2))
    (frame,) = builder.take(contacts(2))
    assert frame.sums.size == frame.valid_sums.size == 0
    assert frame.sampled_error_s == pytest.approx(2e-6)  # the image has it, too
    assert frame.sampled_at == pytest.approx(7.02)  # the offset of the clocks is that of the measurement before


def test_the_wall_clock_is_unknown_before_the_first_measurement(builder: FrameBuilder) -> None:
    builder.take(image(2))
    assert math.isnan(builder.take(contacts(2))[0].sampled_at)


def test_an_unknown_error_is_infinite(builder: FrameBuilder) -> None:
    builder.take(msgspec.structs.replace(image(2), sampled_error_ns=-1))
    assert builder.take(contacts(2))[0].sampled_error_s == math.inf


def test_what_is_not_known_is_told(builder: FrameBuilder) -> None:
    """A label of too few sums, contacts of a blind skin."""
    builder.take(msgspec.structs.replace(label(1, ""), valid_sums=0))
    builder.take(image(1))
    (frame,) = builder.take(contacts(1, blind=True))
    assert (frame.label, frame.is_blind, frame.contacts) == (None, True, ())


def test_a_label_stands_for_half_a_second_and_no_label_is_none(builder: FrameBuilder) -> None:
    def frame_of(cycle: int) -> str | None:
        builder.take(image(cycle))
        return builder.take(contacts(cycle))[0].label

    assert frame_of(1) is None
    builder.take(label(2))
    assert frame_of(2) == "cup"
    assert frame_of(52) == "cup"
    assert frame_of(53) is None
    builder.take(label(54, "", blind=False))
    assert frame_of(54) == ""
    builder.take(label(55, "", blind=True))
    assert frame_of(55) is None
    builder.take(label(70))
    assert frame_of(69) is None  # a label of later sums is none of this frame


def test_messages_of_another_layout_are_refused_and_counted(builder: FrameBuilder) -> None:
    builder.take(measurement(1, usable=bytes(3)))
    builder.take(image(1))
    assert builder.take(contacts(1))[0].sums.size == 0
    builder.take(image(2, valid=bytes((1, 1, 1))))
    assert not builder.take(contacts(2))
    assert builder.refused == 2


def test_arrays_are_read_only(builder: FrameBuilder) -> None:
    builder.take(measurement(1))
    builder.take(image(1))
    (frame,) = builder.take(contacts(1))
    for array in (
        frame.forces,
        frame.image,
        frame.positions,
        frame.estimate,
        frame.valid,
        frame.doubtful,
        frame.sums,
        frame.valid_sums,
    ):
        assert not array.flags.writeable


def test_age_is_of_the_monotonic_clock_on_the_same_machine_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canskin.skin_clock.machine", lambda: "this boot")
    monkeypatch.setattr("canskin.skin_clock.time.monotonic_ns", lambda: 1_010_000_000)
    monkeypatch.setattr("canskin.frame.time.time", lambda: 9.01)
    ages = []
    for boot in ("this boot", "another boot", ""):
        builder = FrameBuilder(description(boot))
        builder.take(measurement(1))
        builder.take(image(1))
        ages.append(builder.take(contacts(1))[0].age)
    assert ages == pytest.approx([1.0, 2.0, 2.0])  # the wall clock is 7 s ahead, and has passed 9.01 s


def test_gaps_of_the_grid_are_never_valid() -> None:
    order = np.array([0, 2, 4, 6, 8, 10, 12, 14, 1, 3, 5, 7, 9, 11, 13, 16], "<u4")  # taxel 15 is a gap, 16 no taxel
    builder = FrameBuilder(msgspec.structs.replace(description(), order=order.tobytes()))
    builder.take(image(1))
    (frame,) = builder.take(contacts(1))
    assert np.flatnonzero(~frame.valid.ravel()).tolist() == [15]
    assert np.flatnonzero(np.isnan(frame.image.ravel())).tolist() == [15]


def test_a_skin_that_is_no_grid_has_forces_at_positions_and_no_image() -> None:
    places_m = np.random.default_rng(0).uniform(-0.02, 0.02, (16, 3)).astype("<f4")
    tube = {"rows": 1, "columns": 16, "is_grid": False, "positions": places_m.tobytes()}
    about = msgspec.structs.replace(description(), **tube, normals=np.tile(np.eye(3, dtype="<f4")[2], 16).tobytes())
    builder = FrameBuilder(msgspec.msgpack.decode(msgspec.msgpack.encode(about), type=Description))
    builder.take(image(1, valid=bytes((1, 0))))
    (frame,) = builder.take(contacts(1))
    assert np.array_equal(frame.positions, places_m)
    assert np.array_equal(frame.normals, np.tile((0, 0, 1), (16, 1)))
    assert np.array_equal(np.isnan(frame.forces), ~EVEN.ravel())
    for array in (frame.estimate, frame.valid, frame.doubtful):
        assert array.shape == frame.forces.shape == (16,)
    with pytest.raises(InputError, match=r"'palm' is no grid .* frame.forces"):
        _ = frame.image


def test_a_description_of_an_older_gateway_is_that_of_a_grid() -> None:
    fields = msgspec.to_builtins(description())
    for name in ("is_grid", "positions", "normals"):
        del fields[name]
    about = msgspec.convert(fields, Description)
    assert about.shape == (4, 4)
    assert about.positions_m.shape == about.unit_normals.shape == (0, 3)


def test_a_description_tells_block_and_row_of_each_sum() -> None:
    about = description()
    assert about.block_of_sum.tolist() == [0, 0, 1, 1]
    assert about.row_of_sum.tolist() == [0, 3, 0, 3]
    assert np.array_equal(about.block_of_taxel == 0, EVEN)
