"""A skin in a picture: a grid as it is, and every taxel of other skins once."""

import numpy as np
import pytest

from skin.plane import Plane, view_of
from skin.surface import Surface, surface_of_positions
from tests import surfaces
from tests.layouts import tube_layout

TUBE = surface_of_positions(surfaces.tube().tolist())


@pytest.mark.parametrize("scale", [1, 4])
def test_a_grid_is_its_own_picture(scale: int) -> None:
    plane = Plane(surfaces.grid(7, 9))
    wanted = np.arange(63).reshape(7, 9).repeat(scale, axis=0).repeat(scale, axis=1)
    np.testing.assert_array_equal(plane.cells(scale), wanted)
    np.testing.assert_array_equal(plane.picture(np.arange(63.0), scale), wanted)
    assert plane.places[11].tolist() == pytest.approx([2.5, 1.5])


def test_a_flat_skin_is_seen_from_outside_without_foreshortening() -> None:
    tilt = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    flat = surfaces.places(5, 9) @ tilt
    outwards = np.tile(tilt[2], (45, 1))
    skin = surface_of_positions(np.c_[flat, outwards].tolist())
    right, down, away = view_of(skin)
    np.testing.assert_allclose(away, -tilt[2], atol=1e-9)
    np.testing.assert_allclose(np.cross(right, down), away, atol=1e-9)
    places = Plane(skin).places
    apart = np.linalg.norm(places[skin.edges[:, 0]] - places[skin.edges[:, 1]], axis=1)
    np.testing.assert_allclose(apart, 1.0, atol=1e-6)


def test_positions_in_a_plane_have_x_to_the_right_and_y_up() -> None:
    places_m = surfaces.places(6, 6)
    right, down, away = view_of(surface_of_positions(places_m.tolist()))
    np.testing.assert_allclose((right, down, away), ((1, 0, 0), (0, -1, 0), (0, 0, -1)), atol=1e-9)


@pytest.mark.parametrize("skin", [tube_layout().taxels.surface, TUBE], ids=["half tube", "tube"])
def test_every_taxel_of_a_curved_skin_is_in_the_picture(skin: Surface) -> None:
    plane, count = Plane(skin), len(skin.positions_m)
    cells = plane.cells(32)
    pixels = np.bincount(cells[cells >= 0], minlength=count)
    assert pixels.min() > 30  # those at the sides are narrow
    x, y = np.floor(plane.places * 32).astype(int).T
    np.testing.assert_array_equal(cells[y, x], np.arange(count))
    assert cells.shape == (round(32 * plane.height), round(32 * plane.width))
    np.testing.assert_allclose(plane.place(skin.positions_m[5], skin.normals[5]), plane.places[5])
