"""Images from the Walsh sums of patches."""

import numpy as np
import pytest

from canskin.errors import InputError
from reconstructor.kernels.graph import graph_of
from reconstructor.walsh import STEPS, VariationFilter, WalshReconstructor
from skin.surface import grid_surface
from skin.walsh import patches, walsh_matrix
from tests.reconstructor.reference import Variation

ROWS, COLUMNS = 8, 16
NO_GAPS = np.zeros(0, np.intp)
PATCHES = patches(grid_surface(ROWS, COLUMNS, 1.0, NO_GAPS), 16, [4, 4], NO_GAPS)
CELLS = np.concatenate(PATCHES)


def sums_of(image: np.ndarray) -> np.ndarray:
    return (image.ravel()[CELLS] @ walsh_matrix(16).T).astype(np.float32)


def test_exact_sums_give_the_exact_image() -> None:
    image = np.random.default_rng(0).random((ROWS, COLUMNS)).astype(np.float32)
    solved = WalshReconstructor(PATCHES, ROWS, COLUMNS, 0.0).solve(sums_of(image))
    np.testing.assert_allclose(solved, image, atol=1e-6)


def test_the_filter_is_the_proximal_step_that_goes_on_from_image_to_image() -> None:
    rng, fast, plain = (
        np.random.default_rng(1),
        VariationFilter(graph_of(ROWS, COLUMNS, NO_GAPS, None)),
        Variation((ROWS, COLUMNS), STEPS),
    )
    for limit in (0.3, 0.3, 0.1):
        image = rng.normal(0.5, 1, (ROWS, COLUMNS)).astype(np.float32)
        np.testing.assert_allclose(fast(image, limit), plain(image.astype(np.float64), limit, 0), atol=1e-5)


def test_noise_falls_and_an_edge_stays() -> None:
    rng, noise_n = np.random.default_rng(2), 1e-4
    true = np.zeros((ROWS, COLUMNS), np.float32)
    true[2:6, 5:11] = 0.01
    solver = WalshReconstructor(PATCHES, ROWS, COLUMNS, 10 * noise_n)
    noisy = true + rng.normal(0, noise_n, true.shape).astype(np.float32)
    for _ in range(20):
        solved = solver.solve(sums_of(noisy))
    assert np.sqrt(np.mean((solved - true) ** 2)) < 0.7 * noise_n
    assert solved.min() == 0
    # The limit bounds how far total variation can move a taxel: by four neighbours' limits.
    assert np.abs(solved - np.maximum(noisy, 0)).max() <= 4.01 * noise_n


def test_what_has_not_come_counts_as_0() -> None:
    image = np.full((ROWS, COLUMNS), 0.01, np.float32)
    sums_n = sums_of(image)
    sums_n[3] = 0
    solved = WalshReconstructor(PATCHES, ROWS, COLUMNS, 0.0).solve(sums_n).ravel()
    assert not solved[CELLS[3]].any()
    np.testing.assert_allclose(np.delete(solved, CELLS[3]), 0.01, atol=1e-6)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="each of 128 taxels once"):
        WalshReconstructor([*PATCHES, PATCHES[0]], ROWS, COLUMNS, 0.0)
    solver = WalshReconstructor(PATCHES, ROWS, COLUMNS, 0.0)
    with pytest.raises(InputError, match="sums: expected an array of float32 or float64 of shape"):
        solver.solve(np.zeros((3, 16), np.float32))
    with pytest.raises(InputError, match="NaN"):
        solver.solve(np.full((8, 16), np.nan, np.float32))
