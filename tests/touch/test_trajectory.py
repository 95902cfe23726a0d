import numpy as np
import pytest

from canskin.errors import InputError
from touch.contact import Grid, press
from touch.objects import spheres_of
from touch.trajectory import ACQUISITION_OBJECTS, paper_pose, start_of, trajectory


def test_the_papers_five_objects_and_which_start_is_exact() -> None:
    assert tuple(ACQUISITION_OBJECTS) == ("golf-ball", "granola-box", "drill", "cup", "clamp")
    assert [name for name, start in ACQUISITION_OBJECTS.items() if start.exact] == ["golf-ball"]


def test_a_trajectory_is_the_object_along_the_papers_poses() -> None:
    force_n = trajectory("drill", steps=1300)
    assert force_n.shape == (1300, 64, 64)
    assert force_n.dtype == np.float32
    start = start_of("drill")
    for step in (0, 101, 1099, 1299):
        pose = paper_pose(step, start.start_m, start.rotation_rad)
        np.testing.assert_array_equal(force_n[step], press(Grid(), [(spheres_of("drill"), pose)]))


def test_speed_leaves_steps_out() -> None:
    slow, fast = trajectory("golf-ball"), trajectory("golf-ball", speed=10)
    assert slow.shape == (4200, 64, 64)
    np.testing.assert_array_equal(fast, slow[::10])
    np.testing.assert_array_equal(trajectory("golf-ball", speed=11)[-1], slow[4191])
    np.testing.assert_array_equal(trajectory("golf-ball", speed=10, steps=7), slow[:70:10])


@pytest.mark.parametrize(("speed", "steps"), [(0, None), (4201, None), (1, 0), (1, 4201), (10, 421)])
def test_impossible_lengths_are_refused(speed: int, steps: int | None) -> None:
    with pytest.raises(InputError, match="expected"):
        trajectory("golf-ball", speed=speed, steps=steps)


def test_objects_without_a_trajectory_are_refused() -> None:
    with pytest.raises(InputError, match=r"'banana'.*golf-ball"):
        start_of("banana")
