"""Energies and peaks of the smoothed adjoint image."""

import tracemalloc

import numpy as np
import pytest

from classifier.features import WIDTHS, Smoothed, widths_for
from skin.layout import Layout
from skin.measurement import Sbhe, sbhe


def measured(phi: Sbhe, sums: np.ndarray, valid: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    smoothed = Smoothed(phi, 32, 32)
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


def test_energy_grows_with_the_square(phi: Sbhe, sums: np.ndarray) -> None:
    energies, peaks = measured(phi, sums)
    energies3, peaks3 = measured(phi, 3 * sums)
    np.testing.assert_allclose(energies3, 9 * energies, rtol=1e-4)
    np.testing.assert_allclose(peaks3, 3 * peaks, rtol=1e-4)


def test_widths_fit_the_array(layout: Layout) -> None:
    assert widths_for(64, 64) == WIDTHS
    assert max(widths_for(32, 64)) <= 8
    assert widths_for(8, 8)


def test_measuring_allocates_nothing_worth_mentioning(phi: Sbhe, sums: np.ndarray) -> None:
    smoothed = Smoothed(phi, 32, 32)
    valid = np.ones(phi.blocks, np.float32)
    valid[0] = 0
    narrow = sums.astype(np.int32)
    smoothed.measure(narrow, valid, 0.9)
    tracemalloc.start()
    try:
        smoothed.measure(narrow, valid, 0.9)
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        smoothed.measure(narrow, valid, 0.9)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak - before < sums.nbytes  # less than any one array of the measurement


def test_no_product_of_two_weights_is_subnormal() -> None:
    """Processors multiply subnormal numbers a hundred times slower, and a tail of that size changes no figure."""
    smoothed = Smoothed(sbhe(4096, 1024), 64, 64)
    for stage in smoothed._stages:
        weights = np.concatenate([stage._left.ravel(), stage._right.ravel()])
        assert (weights[weights > 0].astype(np.float64) ** 2).min() >= np.finfo(np.float32).tiny
