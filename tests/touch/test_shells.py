"""Objects pressed against skins of any shape."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skin.surface import Surface, grid_surface, surface_of_positions
from touch.contact import Grid, Pose, Shell, Spheres, Vector, press, tangents
from touch.objects import spheres_of
from touch.primitives import ball
from touch.random_touches import random_touches
from touch.strokes import DEPTH_M, LABEL_FORCE_N, LIVE, draw_touch, random_stream
from touch.tracks import border_m, track

PITCH_M = 0.004
RADIUS_M = 0.04
AROUND, RINGS = 60, 30
Forces = npt.NDArray[np.float64]


def tube(radius_m: float = RADIUS_M, around: int = AROUND, rings: int = RINGS, spread: float = 1.0) -> Surface:
    """Return a tube along z, or a part of one, of rows in quincunx."""
    ring, step = np.divmod(np.arange(rings * around), around)
    angle = 2 * np.pi * spread * (step + 0.5 * (ring % 2)) / around
    outwards = np.stack((np.cos(angle), np.sin(angle), np.zeros(angle.size)), axis=1)
    places = radius_m * outwards + np.outer(0.9 * PITCH_M * ring, (0, 0, 1))
    return surface_of_positions(np.hstack((places, outwards)).tolist())


TUBE = tube()
SHELL = Shell(TUBE, PITCH_M / 2)


def ball_shaped(count: int = 1500, radius_m: float = RADIUS_M) -> Surface:
    """Return a sphere of evenly spread taxels (a Fibonacci lattice)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - 5**0.5) * np.arange(count)
    flat = np.sqrt(1 - z * z)
    outwards = np.stack((flat * np.cos(angle), flat * np.sin(angle), z), axis=1)
    return surface_of_positions(np.hstack((radius_m * outwards, outwards)).tolist())


def upon(surface: Surface, taxel: int, depth_m: float, rotation_rad: float = 0.0) -> Pose:
    """Return the pose of an object that presses on a taxel."""
    x, y, z = surface.positions_m[taxel].tolist()
    normal: Vector = tuple(surface.normals[taxel].tolist())
    return Pose(x, y, rotation_rad, depth_m, z, normal)


def by_moving(skin: Shell, spheres: Spheres, pose: Pose, step_m: float = 2e-6) -> Forces:
    """Move every touched taxel inwards in small steps until no sphere overlaps it; spheres come from outside."""
    normal = np.array(pose.normal)
    first, second = (np.array(each) for each in tangents(pose.normal))
    cos, sin = math.cos(pose.rotation_rad), math.sin(pose.rotation_rad)
    x, y, z = spheres.centres_m.T
    across = np.outer(cos * x - sin * y, first) + np.outer(sin * x + cos * y, second)
    centres = np.array((pose.x_m, pose.y_m, pose.z_m)) + across - np.outer(pose.depth_m + z, normal)
    found = np.zeros(len(skin.surface.positions_m))
    for taxel, (place, out) in enumerate(zip(skin.surface.positions_m, skin.surface.normals, strict=True)):
        middle = place - skin.taxel_radius_m * out
        for centre, radius in zip(centres, spheres.radii_m, strict=True):
            way = centre + np.outer(np.arange(0, 0.2, 5e-5), normal)
            is_met = np.linalg.norm(way - middle, axis=1).min() < radius + skin.taxel_radius_m
            if not is_met or (out @ normal <= 0 and (middle - centre) @ out > 0):
                continue
            moved = np.arange(0.0, 0.04, step_m)
            away = np.linalg.norm(middle - np.outer(moved, out) - centre, axis=1)
            overlaps = np.flatnonzero(away < radius + skin.taxel_radius_m)
            found[taxel] = max(found[taxel], moved[overlaps[-1]] if overlaps.size else 0.0)
    return found


@pytest.mark.parametrize("name", ["golf-ball", "mustard-upright"])
@pytest.mark.parametrize("surface", [tube(rings=12, around=30, spread=0.5), ball_shaped(300)])
def test_a_taxel_moves_along_its_normal_until_it_is_free(name: str, surface: Surface) -> None:
    skin = Shell(surface, surface.pitch_m / 2)
    for taxel in (7, len(surface.positions_m) // 2):
        pose = upon(surface, taxel, 0.006, 0.7)
        force_n = press(skin, [(spheres_of(name), pose)]).ravel()
        assert (force_n > 0).sum() >= 3
        # Where a sphere is just met, and where its way is looked at in steps, a taxel may differ as a root.
        np.testing.assert_allclose(force_n, by_moving(skin, spheres_of(name), pose), rtol=0, atol=2e-5)


@given(st.integers(2, 9), st.integers(2, 9), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_a_flat_surface_feels_the_same_as_the_grid(rows: int, columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = grid_surface(rows, columns, PITCH_M, np.empty(0, np.intp))
    shell = Shell(
        surface_of_positions(np.hstack((grid.positions_m, grid.normals)).tolist()), Grid(2, 2, PITCH_M).taxel_radius_m
    )
    for name in ("golf-ball", "cup", "ring"):
        pose = Pose(*rng.uniform(-0.03, 0.03, 2), rng.uniform(0, 7), 0.01)
        expected = press(Grid(rows, columns, PITCH_M), [(spheres_of(name), pose)]).ravel()
        np.testing.assert_allclose(press(shell, [(spheres_of(name), pose)]).ravel(), expected, rtol=0, atol=2e-9)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_an_object_feels_the_same_wherever_and_however_the_skin_lies(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned *= np.linalg.det(turned)
    moved = Surface(
        TUBE.positions_m @ turned.T + rng.uniform(-1, 1, 3),
        TUBE.normals @ turned.T,
        TUBE.edges,
        TUBE.shape,
        is_grid=False,
        pitch_m=TUBE.pitch_m,
    )
    taxel, radius_m = int(rng.integers(len(TUBE.positions_m))), float(rng.uniform(0.005, 0.05))
    here = press(SHELL, [(ball(2 * radius_m), upon(TUBE, taxel, 0.005))])
    there = press(Shell(moved, PITCH_M / 2), [(ball(2 * radius_m), upon(moved, taxel, 0.005))])
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-6)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_forces_on_any_surface_are_finite_and_the_same_again(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = grid_surface(6, 8, PITCH_M, np.empty(0, np.intp)).positions_m + rng.uniform(-0.0008, 0.0008, (48, 3))
    places[:, 2] += rng.uniform(-8, 8) * places[:, 0] ** 2 + rng.uniform(-8, 8) * places[:, 1] ** 2
    surface = surface_of_positions(places.tolist())
    skin = Shell(surface, surface.pitch_m / 2)
    for name in ("golf-ball", "mustard-upright", "ring"):
        touch = draw_touch(name, skin, random_stream(seed, LIVE, 0))
        again = draw_touch(name, Shell(surface, surface.pitch_m / 2), random_stream(seed, LIVE, 0))
        for time_s in np.linspace(0.0, touch.stroke.duration_s, 7):
            force_n = touch.force_n(skin, touch.stroke.pose(time_s))
            assert force_n.shape == (1, 48)
            assert np.isfinite(force_n).all()
            assert force_n.min() >= 0.0
            np.testing.assert_array_equal(force_n, again.force_n(skin, again.stroke.pose(time_s)))


def test_a_slide_stays_on_the_skin_and_keeps_its_depth() -> None:
    for index in range(30):
        touch = draw_touch("golf-ball", SHELL, random_stream(0, LIVE, index))
        assert touch.stroke.end_m[0] <= 0.0901
        for time_s in np.linspace(0.3, 2.7, 9):
            pose = touch.stroke.pose(time_s)
            assert math.hypot(pose.x_m, pose.y_m) == pytest.approx(RADIUS_M, rel=0.01)
            assert np.dot(pose.normal, (pose.x_m, pose.y_m, 0.0)) == pytest.approx(RADIUS_M, rel=0.01)
            assert 0.9 * DEPTH_M[0] < touch.force_n(SHELL, pose).max() < 1.05 * DEPTH_M[1]


def test_a_way_on_a_flat_surface_is_straight_and_keeps_the_rotation() -> None:
    grid = grid_surface(20, 24, PITCH_M, np.empty(0, np.intp))
    way = track(grid, 30, np.array((0.001, 0.0005)), np.array((0.02, 0.01, 0.0)), 0.1)
    start = grid.positions_m[30] + (0.001, 0.0005, 0.0)
    assert way.length_m == pytest.approx(np.linalg.norm(start - (0.02, 0.01, 0.0)))
    for ratio in (0.0, 0.31, 1.0, 1.5):
        pose = way.placed(Pose(ratio * way.length_m, 0.0, 0.4, 0.005))
        x_m, y_m, _ = start + min(ratio, 1.0) * ((0.02, 0.01, 0.0) - start)
        assert pose[:5] == pytest.approx((x_m, y_m, 0.4, 0.005, 0.0), abs=1e-12)
        assert pose.normal == pytest.approx((0.0, 0.0, -1.0))


def test_a_way_ends_where_the_skin_ends() -> None:
    half = tube(spread=0.5)
    way = track(half, RINGS // 2 * AROUND, np.zeros(2), np.array((0.0, -RADIUS_M, 0.05)), 0.1)
    assert way.length_m < 3 * PITCH_M


def test_the_border_of_a_tube_is_its_two_ends_and_a_closed_skin_has_none() -> None:
    at_end = border_m(TUBE) < PITCH_M
    assert np.array_equal(np.flatnonzero(at_end) // AROUND, np.repeat((0, RINGS - 1), AROUND))
    assert np.isinf(border_m(ball_shaped())).all()


def test_a_press_is_within_10_mm_of_the_middle() -> None:
    middle = TUBE.positions_m[int(np.argmax(border_m(TUBE)))]
    for index in range(20):
        stroke = draw_touch("golf-ball", SHELL, random_stream(0, LIVE, index), "press").stroke
        held = stroke.pose(1.0)
        assert held == stroke.pose(2.0)
        assert np.linalg.norm((held.x_m, held.y_m, held.z_m) - middle) <= 0.0142


def test_training_touches_of_a_surface_are_felt() -> None:
    found = random_touches(["golf-ball", "ring"], 20, surface=TUBE, seed=3)
    assert found.force_n.shape == (20, 1, AROUND * RINGS)
    assert found.force_n.max(axis=(1, 2)).min() >= LABEL_FORCE_N
    assert len({int(each.argmax()) for each in found.force_n}) > 10
