import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import InputError
from touch.contact import Grid, Pose, Spheres, press
from touch.primitives import ball

GRID = Grid(20, 24, 0.004)
small = st.floats(-0.03, 0.03)
bodies = st.lists(st.tuples(small, small, st.floats(-0.02, 0.0), st.floats(0.001, 0.02)), min_size=1, max_size=6).map(
    lambda rows: Spheres(np.array(rows)[:, :3], np.array(rows)[:, 3])
)
poses = st.tuples(small, small, st.floats(-7.0, 7.0), st.floats(-0.002, 0.02)).map(lambda each: Pose(*each))


def by_definition(grid: Grid, spheres: Spheres, pose: Pose) -> npt.NDArray[np.float64]:
    """Every taxel against every sphere, without any shortcut."""
    cos, sin = math.cos(pose.rotation_rad), math.sin(pose.rotation_rad)
    x, y, z = spheres.centres_m.T
    at_x, at_y = pose.x_m + cos * x - sin * y, pose.y_m + sin * x + cos * y
    taxel_x = (np.arange(grid.columns) - (grid.columns - 1) / 2) * grid.pitch_m
    taxel_y = (np.arange(grid.rows) - (grid.rows - 1) / 2) * grid.pitch_m
    squared = (taxel_x[None, :, None] - at_x) ** 2 + (taxel_y[:, None, None] - at_y) ** 2
    reach = spheres.radii_m + grid.taxel_radius_m
    height = z + np.sqrt(np.maximum(reach**2 - squared, 0.0)) - grid.taxel_radius_m
    height = np.where(squared < reach**2, height, -np.inf)
    deepest: npt.NDArray[np.float64] = np.maximum(0.0, pose.depth_m + height.max(axis=2))
    return deepest


@given(bodies, poses)
def test_force_is_the_deepest_compression_by_any_sphere(spheres: Spheres, pose: Pose) -> None:
    force_n = press(GRID, [(spheres, pose)])
    assert force_n.dtype == np.float32
    np.testing.assert_allclose(force_n, by_definition(GRID, spheres, pose), rtol=0, atol=2e-9)


@given(st.lists(st.tuples(bodies, poses), max_size=4))
@settings(max_examples=50)
def test_several_objects_press_by_their_maximum(objects: list[tuple[Spheres, Pose]]) -> None:
    alone = [press(GRID, [item]) for item in objects]
    expected = np.max(alone, axis=0, initial=0.0) if alone else np.zeros((20, 24))
    np.testing.assert_array_equal(press(GRID, objects), expected.astype(np.float32))


def test_x_runs_along_the_columns_and_y_down_the_rows() -> None:
    force_n = press(Grid(), [(ball(0.02), Pose(0.126, -0.126, 0.0, 0.003))])
    assert force_n.argmax() == 63
    assert force_n[0, 63] == np.float32(0.003)


def test_an_object_beside_the_array_is_not_felt() -> None:
    for x, y in ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3), (1e300, -1e300)):
        assert not press(Grid(), [(ball(0.04), Pose(x, y, 0.0, 0.01))]).any()


@pytest.mark.parametrize(
    ("centres", "radii"),
    [
        (np.zeros((2, 2)), np.ones(2)),
        (np.zeros((2, 3)), np.ones(3)),
        (np.zeros((0, 3)), np.ones(0)),
        (np.zeros((1, 3)), np.zeros(1)),
        (np.full((1, 3), np.nan), np.ones(1)),
    ],
)
def test_wrong_spheres_are_refused(centres: npt.NDArray[np.float64], radii: npt.NDArray[np.float64]) -> None:
    with pytest.raises(InputError):
        Spheres(centres, radii)


def test_wrong_arrays_and_poses_are_refused() -> None:
    for wrong in ({"rows": 0}, {"columns": -1}):
        with pytest.raises(InputError, match="at least 1 x 1"):
            Grid(**wrong)
    for name in ("pitch_m", "taxel_radius_m"):
        for length in (0.0, -1.0, math.nan, math.inf):
            with pytest.raises(InputError, match=name):
                Grid(8, 8, **{name: length})
    with pytest.raises(InputError, match="finite"):
        press(Grid(), [(ball(0.04), Pose(math.nan, 0.0, 0.0, 0.01))])
