import math

import numpy as np
import pytest

from canskin.errors import InputError
from touch.classification_poses import CLASSIFICATION_OBJECTS
from touch.contact import Grid, Pose, Spheres, press
from touch.objects import CATALOGUE, FACING_M, checked_names, size_m, spheres_of
from touch.primitives import box, can, ring
from touch.trajectory import PAPER_DEPTH_M

FINE = Grid(300, 300, 0.001, 1e-6)


def extent_m(spheres: Spheres, axis: int) -> float:
    at = spheres.centres_m[:, axis]
    return float((at + spheres.radii_m).max() - (at - spheres.radii_m).min())


@pytest.mark.parametrize("name", CATALOGUE)
def test_sizes_are_exact_and_centred(name: str) -> None:
    spheres, item = spheres_of(name), CATALOGUE[name]
    if item.shape in {"ball", "box"}:
        assert extent_m(spheres, 0) == pytest.approx(item.size_m[0], abs=1e-12)
        assert extent_m(spheres, 1) == pytest.approx(item.size_m[1], abs=1e-12)
    reach = np.hypot(spheres.centres_m[:, 0], spheres.centres_m[:, 1]) + spheres.radii_m
    if item.shape == "own shape":
        assert spheres.footprint_m(FACING_M) == pytest.approx(item.size_m, abs=5e-4)
    elif item.shape != "box":
        assert 2 * reach.max() == pytest.approx(item.size_m[0], abs=1e-12)
    if item.shape != "own shape":
        np.testing.assert_allclose(spheres.centres_m[:, :2].mean(axis=0), 0.0, atol=1e-12)
    assert (spheres.centres_m[:, 2] + spheres.radii_m).max() == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("name", "ripple_m"), [("granola-box", 2.5e-4), ("jello-box", 2.5e-4), ("tuna-can", 2.5e-4)])
def test_faces_are_flat_where_taxels_touch(name: str, ripple_m: float) -> None:
    force_n = press(Grid(), [(spheres_of(name), Pose(0.0, 0.0, 0.2, PAPER_DEPTH_M))])
    middle = force_n[30:34, 30:34]
    assert middle.min() > PAPER_DEPTH_M - ripple_m


def test_a_box_is_a_rectangle_with_its_length_along_x() -> None:
    pressed = press(FINE, [(box(0.1, 0.05), Pose(0.0, 0.0, 0.0, 0.001))]) > 0
    rows, columns = np.nonzero(pressed)
    assert columns.max() - columns.min() + 1 == pytest.approx(100, abs=1)
    assert rows.max() - rows.min() + 1 == pytest.approx(50, abs=1)
    assert pressed.sum() == pytest.approx(5000, rel=0.03)


def test_a_can_is_a_disc_and_a_ring_is_hollow() -> None:
    disc = press(FINE, [(can(0.08), Pose(0.0, 0.0, 0.0, 0.006))]) > 0
    assert disc.sum() == pytest.approx(math.pi * 40**2, rel=0.02)
    rim = press(FINE, [(ring(0.08, 0.004), Pose(0.0, 0.0, 0.0, 0.003))]) > 0
    assert rim.sum() == pytest.approx(math.pi * (40**2 - 36**2), rel=0.03)
    assert not rim[130:170, 130:170].any()


def test_contact_counts_at_full_depth() -> None:
    def contact(name: str) -> int:
        return int((press(Grid(), [(spheres_of(name), Pose(0.0, 0.0, 0.0, PAPER_DEPTH_M))]) > 0).sum())

    assert contact("golf-ball") == 76
    assert contact("granola-box") == 936
    assert contact("gravy-can") < contact("tuna-can") < contact("salmon-can")


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'spoon'.*golf-ball.*ring"):
        spheres_of("spoon")
    for several in ("ring,cup", "paper"):
        with pytest.raises(InputError, match=f"unknown object '{several}'"):
            size_m(several)
    with pytest.raises(InputError, match="no object named"):
        checked_names([])
    with pytest.raises(InputError, match="no object named"):
        checked_names("")
    assert checked_names("ring, golf-ball") == ("ring", "golf-ball")


def test_a_group_stands_for_its_objects() -> None:
    assert checked_names("paper") == CLASSIFICATION_OBJECTS
    assert len(set(CLASSIFICATION_OBJECTS)) == 16
    assert set(CLASSIFICATION_OBJECTS) == set(CATALOGUE) - {"golf-ball", "ring"}
    assert checked_names(["ring", "paper"])[:2] == ("ring", "racquetball")
    assert checked_names(["cup", "paper", "cup"]) == (
        "cup",
        *(each for each in CLASSIFICATION_OBJECTS if each != "cup"),
    )
    with pytest.raises(InputError, match="expected one of paper, golf-ball"):
        checked_names("papers")
