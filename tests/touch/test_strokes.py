import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from touch.contact import Grid
from touch.strokes import LIVE, PAUSE_S, SLOT_S, Stroke, draw_touch, random_stream
from touch.trajectory import PAPER_DEPTH_M

duration = st.floats(0.0, 3.0)
place = st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
strokes = st.builds(
    Stroke, place, place, st.floats(-7, 7), st.floats(0.001, 0.02), duration, duration, duration, duration
)
STROKE = Stroke((0.0, 0.01), (0.04, -0.01), 1.5, 0.01, press_s=0.5, hold_s=1.0, slide_s=2.0, lift_s=0.25)


@given(strokes, st.floats(-1.0, 14.0))
def test_a_stroke_stays_between_its_ends_and_within_its_depth(stroke: Stroke, time_s: float) -> None:
    pose = stroke.pose(time_s)
    for at, start, end in zip(pose[:2], stroke.start_m, stroke.end_m, strict=True):
        assert min(start, end) - 1e-12 <= at <= max(start, end) + 1e-12
    assert 0.0 <= pose.depth_m <= stroke.depth_m
    assert pose.rotation_rad == stroke.rotation_rad


@pytest.mark.parametrize(
    ("time_s", "x_m", "y_m", "depth_m"),
    [
        (-1.0, 0.0, 0.01, 0.0),
        (0.25, 0.0, 0.01, 0.005),
        (0.5, 0.0, 0.01, 0.01),
        (1.5, 0.0, 0.01, 0.01),
        (2.5, 0.02, 0.0, 0.01),
        (3.5, 0.04, -0.01, 0.01),
        (3.625, 0.04, -0.01, 0.005),
        (3.75, 0.04, -0.01, 0.0),
        (9.0, 0.04, -0.01, 0.0),
    ],
)
def test_press_hold_slide_lift(time_s: float, x_m: float, y_m: float, depth_m: float) -> None:
    assert STROKE.duration_s == 3.75
    assert STROKE.pose(time_s)[:4] == pytest.approx((x_m, y_m, 1.5, depth_m), abs=1e-12)


def test_a_press_is_one_of_the_papers_perturbations_without_a_slide() -> None:
    drawn = [draw_touch("cup", Grid(), random_stream(0, LIVE, index), "press").stroke for index in range(200)]
    held = [stroke.pose(stroke.press_s + 0.1) for stroke in drawn]
    for stroke, pose in zip(drawn, held, strict=True):
        assert pose == stroke.pose(stroke.duration_s - stroke.lift_s - 0.1)
        assert pose.depth_m == PAPER_DEPTH_M
        assert stroke.duration_s == pytest.approx(SLOT_S - PAUSE_S)
    for at, most in zip(np.abs([pose[:3] for pose in held]).T, (0.01, 0.01, np.pi / 4), strict=True):
        assert 0 <= at.min() < 0.05 * most
        assert 0.95 * most < at.max() <= most
    assert max(max(pose[:3]) for pose in held) <= 0
