import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import InputError
from skin.sources import DEFAULT_OBJECTS, load_source
from touch.objects import CATALOGUE
from touch.random_touches import random_touches
from touch.sources import ObjectSource, objects
from touch.strokes import DEPTH_M, LABEL_FORCE_N, SLOT_S

SOURCE = objects(rate_hz=100.0, seed=7)
SLOT = round(SLOT_S * 100)


def test_it_is_the_source_registered_as_objects() -> None:
    source = load_source("objects", rows=64, columns=64, pitch_m=0.004, rate_hz=100.0, seed=7)
    assert isinstance(source, ObjectSource)
    assert not source.has_noise
    for step in (0, 50, 150, SLOT + 90):
        np.testing.assert_array_equal(source.frame(step).force_n, SOURCE.frame(step).force_n)


@pytest.mark.heavy
@given(st.lists(st.integers(0, 20 * SLOT), min_size=2, max_size=6))
@settings(max_examples=25, deadline=None)
def test_a_frame_depends_on_its_step_alone(steps: list[int]) -> None:
    fresh = objects(rate_hz=100.0, seed=7)
    for step in steps:
        here, there = SOURCE.frame(step), fresh.frame(step)
        np.testing.assert_array_equal(here.force_n, there.force_n)
        assert here.label == there.label


def test_objects_take_turns_with_a_pause_between() -> None:
    frames = [SOURCE.frame(step) for step in range(5 * SLOT)]
    for turn, name in enumerate(DEFAULT_OBJECTS):
        labels = {frame.label for frame in frames[turn * SLOT : (turn + 1) * SLOT]}
        assert labels == {"", name}
        assert not frames[turn * SLOT + 20].force_n.any()
    assert frames[0].label == ""


@given(st.integers(0, 30 * SLOT))
@settings(max_examples=200)
def test_the_label_follows_the_true_peak_force(step: int) -> None:
    force_n, label = SOURCE.frame(step)
    assert force_n.shape == (64, 64)
    assert force_n.dtype == np.float32
    assert force_n.min() >= 0.0
    assert bool(label) == bool(force_n.max() >= LABEL_FORCE_N)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_object_reaches_its_depth_on_the_array(name: str) -> None:
    source = objects(rate_hz=100.0, names=[name], seed=3)
    held = [source.frame(turn * SLOT + 100) for turn in range(12)]
    assert {frame.label for frame in held} == {name}
    assert all(DEPTH_M[0] - 5e-4 < frame.force_n.max() <= DEPTH_M[1] + 1e-8 for frame in held)
    areas = [int((frame.force_n > 0).sum()) for frame in held]
    assert min(areas) > 0.7 * max(areas)
    assert len({float(frame.force_n.sum()) for frame in held}) == 12


def test_a_frame_cannot_be_written_to() -> None:
    for step in (0, 100):
        with pytest.raises(ValueError, match="read-only"):
            SOURCE.frame(step).force_n[0, 0] = 1.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"names": ["golf-ball", "spoon"]}, "unknown object 'spoon': expected one of paper, golf-ball"),
        ({"names": []}, "no object named"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"rate_hz": float("nan")}, "rate_hz"),
        ({"seed": -1}, "seed"),
        ({"rows": 0}, "at least 1 x 1"),
        ({"pitch_m": -0.004}, "pitch_m"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_source("objects", **options)


def test_a_step_before_the_first_is_refused() -> None:
    with pytest.raises(InputError, match="step 0"):
        SOURCE.frame(-1)


def test_training_touches_take_turns_and_are_felt() -> None:
    found = random_touches(DEFAULT_OBJECTS, 50, seed=4)
    assert found.force_n.shape == (50, 64, 64)
    assert found.force_n.dtype == np.float32
    assert found.labels.tolist() == list(DEFAULT_OBJECTS) * 10
    assert (found.force_n.max(axis=(1, 2)) >= LABEL_FORCE_N).all()
    again = random_touches(DEFAULT_OBJECTS, 50, seed=4)
    np.testing.assert_array_equal(found.force_n, again.force_n)
    assert not np.array_equal(found.force_n, random_touches(DEFAULT_OBJECTS, 50, seed=5).force_n)


@pytest.mark.heavy
def test_training_touches_are_distributed_like_live_frames() -> None:
    names = ["racquetball"]
    source = objects(rate_hz=10.0, names=names, seed=1)
    live = [frame for step in range(400 * 34) if (frame := source.frame(step)).label]
    live_n = np.stack([frame.force_n for frame in live])
    drawn_n = random_touches(names, 3000, seed=1).force_n
    levels = np.linspace(0.1, 0.9, 9)
    peaks = [np.quantile(each.max(axis=(1, 2)), levels) for each in (live_n, drawn_n)]
    np.testing.assert_allclose(peaks[0], peaks[1], rtol=0.08)
    for axis in (1, 2):
        profiles = [each.sum(axis=(0, axis)) / each.sum() for each in (live_n, drawn_n)]
        assert np.abs(np.cumsum(profiles[0]) - np.cumsum(profiles[1])).max() < 0.06


def test_training_touches_are_not_those_of_the_live_source() -> None:
    source = objects(names=["golf-ball"], seed=2)
    live = {source.touch(index).stroke.start_m for index in range(20)}
    held = random_touches(["golf-ball"], 20, seed=2).force_n
    shown = [source.frame(index * SLOT + 100).force_n for index in range(20)]
    assert len(live) == 20
    assert not any(np.array_equal(one, other) for one in held for other in shown)


def test_wrong_training_options_are_refused() -> None:
    for names, count, seed in ((["spoon"], 1, 0), ([], 1, 0), (["ring"], -1, 0), (["ring"], 1, -1)):
        with pytest.raises(InputError):
            random_touches(names, count, seed=seed)
    with pytest.raises(InputError, match="never felt"):
        random_touches(["ring"], 1, 2, 2, pitch_m=0.004)


def test_a_small_array_is_touched_by_what_it_can_feel() -> None:
    names = objects(16, 16).names
    assert "golf-ball" in names
    assert "ring" not in names
    assert set(random_touches(DEFAULT_OBJECTS, 8, 16, 16, skip_unfelt=True).labels) == set(names)
    with pytest.raises(InputError, match="'ring' is never felt"):
        random_touches(["ring"], 50, 16, 16)


def test_steps_of_a_high_rate_lie_between_poses() -> None:
    slow, quick = (objects(rate_hz=rate_hz, names=["golf-ball"], seed=3) for rate_hz in (100.0, 500.0))
    for step in range(60, 90):
        first, second = slow.frame(step).force_n, slow.frame(step + 1).force_n
        assert np.array_equal(quick.frame(5 * step).force_n, first)
        np.testing.assert_allclose(quick.frame(5 * step + 2).force_n, 0.6 * first + 0.4 * second, atol=1e-8)
    assert slow.frame(90).force_n.max() > LABEL_FORCE_N
    assert quick.frame(452).label == "golf-ball"
