"""Where taxels lie and which are neighbours, against a triangulation and against the grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation
from scipy.spatial import Delaunay

from canskin.errors import LayoutError
from skin.surface import SPACING_MAX_M, grid_surface, surface_of_positions
from tests import surfaces
from tests.surfaces import PITCH_M, places, tube


@given(st.integers(2, 12), st.integers(2, 12))
def test_positions_of_a_grid_have_the_edges_of_the_grid(rows: int, columns: int) -> None:
    grid = surfaces.grid(rows, columns)
    found = surface_of_positions(grid.positions_m.tolist())
    assert np.array_equal(found.edges, grid.edges)
    assert found.pitch_m == pytest.approx(PITCH_M)
    assert found.is_flat
    assert found.shape == (1, rows * columns)
    assert np.allclose(found.normals, (0, 0, 1))


@given(st.integers(0, 2**32 - 1))
def test_edges_are_some_of_a_triangulation_and_join_all_taxels(seed: int) -> None:
    moved = places(6, 8)[:, :2] + np.random.default_rng(seed).uniform(-0.0008, 0.0008, (48, 2))
    found = surface_of_positions(np.c_[moved, np.zeros(48)].tolist())
    corners = Delaunay(moved).simplices
    allowed = {tuple(sorted((each[a], each[b]))) for each in corners.tolist() for a, b in ((0, 1), (1, 2), (0, 2))}
    assert {tuple(edge) for edge in found.edges.tolist()} <= allowed
    assert not found.islands.any()


def test_no_edge_crosses_a_gap() -> None:
    kept = [taxel for taxel in range(64) if taxel % 8 != 4]  # a column is missing
    found = surface_of_positions(places(8, 8)[kept].tolist())
    columns = np.array(kept) % 8
    assert np.array_equal(found.islands, (columns > 4).astype(int))
    gaps = np.arange(4, 64, 8)
    assert len(grid_surface(8, 8, PITCH_M, gaps).edges) == len(found.edges)


@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 4), st.integers(0, 2**32 - 1))
def test_taxels_spread_over_a_grid_as_another_library_dilates_them(
    rows: int, columns: int, steps: int, seed: int
) -> None:
    touched = np.random.default_rng(seed).random((rows, columns)) < 0.1
    expected = binary_dilation(touched, iterations=steps) if steps else touched
    assert np.array_equal(surfaces.grid(rows, columns).spread(touched.ravel(), steps), expected.ravel())


def test_taxels_spread_over_the_seam_of_a_tube_and_not_over_a_gap() -> None:
    skin = surface_of_positions(tube().tolist())
    touched = np.arange(240) == 5 * 24  # the first of ring 5
    near = np.linalg.norm(tube() - tube()[touched], axis=1) < 0.009
    assert np.array_equal(skin.spread(touched, 1), near)
    patches = surfaces.two_patches()
    assert np.array_equal(patches.spread(patches.islands == 0, 20), patches.islands == 0)


def test_a_taxel_is_named_by_its_number_and_on_a_grid_by_its_row_and_column_too() -> None:
    assert surfaces.grid(8, 10).name_of(34) == "taxel 34 (row 3, column 4)"
    assert surfaces.two_patches().name_of(34) == "taxel 34"


def test_a_tube_is_not_flat_and_its_normals_point_outwards() -> None:
    found = surface_of_positions(tube().tolist())
    outwards = tube() * (1, 1, 0) / 0.03
    assert (found.normals * outwards).sum(axis=1).min() > 0.99
    assert not found.is_flat
    assert not found.islands.any()


def test_a_thin_finger_has_no_edges_through_it() -> None:
    """Front and back are nearer to each other than neighbours are."""
    front = places(6, 6)
    back = front + np.array((0, 0, -0.5 * PITCH_M))
    both = np.c_[np.r_[front, back], np.repeat(((0, 0, 1), (0, 0, -1)), 36, axis=0)]
    found = surface_of_positions(both.tolist())
    assert (found.edges[:, 0] // 36 == found.edges[:, 1] // 36).all()
    assert len(found.edges) == 2 * 60


GRID = places(4, 4).tolist()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ([*GRID, GRID[3]], "taxels 3 and 16 lie at the same place"),
        ([[0, 0, 0]] * 9, "at the same place"),
        ((1000 * np.array(GRID)).tolist(), "look like millimetres"),
        ([*GRID[:-1], [0, 0, float("nan")]], "expected finite numbers.*taxel 15"),
        ([*GRID[:-1], [0, 0]], r"got \[2, 3\] numbers"),
        ([*GRID, [1, 1, 1]], "taxel 16 has no neighbour within 1.6 times the median spacing of 4 mm"),
        ([[*place, 0, 0, 0] for place in GRID], "the normal of taxel 0 has length 0"),
    ],
)
def test_wrong_positions_have_one_clear_error(table: list[list[float]], words: str) -> None:
    with pytest.raises(LayoutError, match=words):
        surface_of_positions(table)


def test_the_limit_of_metres_is_above_any_skin() -> None:
    assert surface_of_positions((0.9 * SPACING_MAX_M / PITCH_M * places(3, 3)).tolist()).is_flat
