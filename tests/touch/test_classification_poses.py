import math
from typing import get_args

import numpy as np
import pytest

from canskin.errors import InputError
from touch.classification_poses import PERTURBATIONS, observations, poses
from touch.coarse_arrays import Kind
from touch.contact import Grid, Pose, press
from touch.objects import spheres_of


def test_the_papers_360_offsets() -> None:
    every = poses()
    assert len(every) == len(set(every)) == PERTURBATIONS == 360
    assert every[0] == Pose(0.0, 0.0, 0.0, 0.00999)
    assert every[-1][:4] == pytest.approx((-0.01, -0.01, -math.pi / 4, 0.00999))
    assert every[1][:4] == pytest.approx((0.0, 0.0, -math.radians(5), 0.00999))


def test_fewer_are_a_seeded_draw_without_repetition() -> None:
    drawn = poses(40, seed=3)
    assert len(set(drawn)) == 40
    assert set(drawn) < set(poses())
    assert drawn == poses(40, seed=3) != poses(40, seed=4)


def test_an_index_is_the_same_touch_for_every_object_and_array() -> None:
    names = ("drill", "tuna-can")
    fine = observations(perturbations=5, seed=1, names=names)
    assert fine.shape == (2, 5, 64, 64)
    for index, pose in enumerate(poses(5, seed=1)):
        for row, name in enumerate(names):
            np.testing.assert_array_equal(fine[row, index], press(Grid(), [(spheres_of(name), pose)]))
    coarse = observations(4, perturbations=5, seed=1, names=names)
    np.testing.assert_allclose(coarse, fine.reshape(2, 5, 4, 16, 4, 16).mean(axis=(3, 5)), rtol=1e-6)


def test_a_sphere_as_large_as_its_cell_feels_the_largest_force() -> None:
    large, means = (observations(8, kind, perturbations=3, names=["cup"]) for kind in get_args(Kind)[::-1])
    assert large.max() > means.max()


@pytest.mark.parametrize("count", [0, 361])
def test_there_are_no_more_perturbations_than_the_papers(count: int) -> None:
    with pytest.raises(InputError, match=f"1 to 360 perturbations, got {count}"):
        poses(count)


def test_wrong_seeds_and_names_are_refused() -> None:
    with pytest.raises(InputError, match="seed"):
        poses(3, seed=-1)
    with pytest.raises(InputError, match="'spoon'"):
        observations(perturbations=1, names=["spoon"])
