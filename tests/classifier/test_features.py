"""Energies and peaks of the smoothed adjoint image."""

import numpy as np
import pytest

from classifier.features import WIDTHS, Smoothed, widths_for
from skin.phi import Sbhe, sbhe
from skin.surface import surface_of_positions
from tests import surfaces


def measured(phi: Sbhe, sums: np.ndarray, valid: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    smoothed = Smoothed(phi, surfaces.grid(32, 32))
    whole = np.ones(phi.blocks, np.float32) if valid is None else valid
    smoothed.measure(sums.astype(np.int32), whole, float(whole.mean()))
    return smoothed.energies, smoothed.peaks


@pytest.fixture
def sums(phi: Sbhe) -> np.ndarray:
    return phi.forward(np.random.default_rng(4).integers(0, 1023, phi.shape[1]))


def test_first_width_against_the_definition(phi: Sbhe, sums: np.ndarray) -> None:
    kept = np.where(phi.row_of_sum == 0, 0, sums)
    image = phi.adjoint(kept * phi.shape[1] / (phi.shape[0] * phi.block_size)).reshape(32, 32)
    places = np.arange(32)
    kernel = np.exp(-((places[:, None] - places) ** 2) / (2 * WIDTHS[0] ** 2))
    kernel /= np.linalg.norm(kernel[16])
    smooth = kernel @ image @ kernel.T
    energies, peaks = measured(phi, sums)
    assert energies[0] == pytest.approx(np.square(smooth).mean(), rel=1e-4)
    assert peaks[0] == pytest.approx(smooth.max(), rel=1e-4)


def test_common_offset_of_all_taxels_changes_nothing(phi: Sbhe, sums: np.ndarray) -> None:
    shifted = sums + phi.forward(np.full(phi.shape[1], 37))
    for one, other in zip(measured(phi, sums), measured(phi, shifted), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


def test_sums_of_invalid_blocks_do_not_count(phi: Sbhe, sums: np.ndarray) -> None:
    valid = np.ones(phi.blocks, np.float32)
    valid[[3, 7]] = 0
    other = np.where(phi.sums_of_blocks(valid > 0), sums, 12345)
    np.testing.assert_array_equal(measured(phi, sums, valid), measured(phi, other, valid))


def test_widths_fit_the_array() -> None:
    assert widths_for(surfaces.grid(64, 64)) == WIDTHS
    assert max(widths_for(surfaces.grid(32, 64))) <= 8
    assert widths_for(surfaces.grid(8, 8))


def patch(rows: int, columns: int) -> np.ndarray:
    """Return positions of a lattice of triangles 4 mm apart."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return 0.004 * np.stack((column + 0.5 * (row % 2), row * np.sqrt(0.75), np.zeros(row.size)), axis=1)


def test_features_of_a_grid_are_those_of_its_taxels_at_positions(phi: Sbhe, sums: np.ndarray) -> None:
    skin = surface_of_positions(surfaces.places(32, 32).tolist())
    assert widths_for(skin) == widths_for(surfaces.grid(32, 32))
    smoothed = Smoothed(phi, skin)
    smoothed.measure(sums.astype(np.int32), np.ones(phi.blocks, np.float32), 1.0)
    energies, peaks = measured(phi, sums)
    fine = np.array(WIDTHS[: energies.size]) < 2
    np.testing.assert_allclose(smoothed.energies[fine], energies[fine], rtol=1e-2)
    np.testing.assert_allclose(smoothed.peaks[fine], peaks[fine], rtol=1e-2)
    np.testing.assert_allclose(smoothed.energies, energies, rtol=0.15)  # wide ones are looked at in other places
    np.testing.assert_allclose(smoothed.peaks, peaks, rtol=0.15)


def test_features_do_not_depend_on_where_on_a_lattice_the_object_is() -> None:
    positions_m, whole = patch(32, 32), sbhe(1024, 1024, block_size=32)
    skin = surface_of_positions(positions_m.tolist())
    smoothed = Smoothed(whole, skin, means=True)
    inner = np.array(widths_for(skin)) <= 3  # wider ones reach over the border
    seen = []
    for row in range(12, 20, 2):
        for column in range(12, 20):
            apart = np.linalg.norm(positions_m - positions_m[32 * row + column], axis=1) / 0.004
            object_counts = np.rint(np.where(apart < 2.5, 300 - 30 * apart**2, 0)).astype(np.int32)
            smoothed.measure(whole.forward(object_counts), np.ones(32, np.float32), 1.0)
            seen.append(np.concatenate((smoothed.energies[inner], smoothed.peaks[inner])))
    assert inner.sum() == 5
    spread = np.std(seen, axis=0) / np.mean(seen, axis=0)
    assert spread[:5].max() < 0.005
    assert spread[5:].max() < 0.04  # the middle of the object may lie between the places that are looked at


def test_what_presses_on_one_side_of_a_thin_skin_is_not_seen_on_the_other() -> None:
    front = surfaces.places(16, 16)
    both = np.c_[np.r_[front, front - (0, 0, 0.002)], np.repeat(((0, 0, 1), (0, 0, -1)), 256, axis=0)]
    whole = sbhe(512, 512, block_size=32)
    force = np.zeros(512, np.int32)
    force[100:110] = 500
    found = []
    for skin in (surface_of_positions(both.tolist()), surface_of_positions(both[:, :3].tolist()[:256])):
        count = len(skin.positions_m)
        phi = whole if count == 512 else sbhe(256, 256, block_size=32)
        smoothed = Smoothed(phi, skin, means=True)
        smoothed.measure(phi.forward(force[:count]), np.ones(phi.blocks, np.float32), 1.0)
        found.append((smoothed.energies * count, smoothed.peaks))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one[:3], other[:3], rtol=1e-3)
