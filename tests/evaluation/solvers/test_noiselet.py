"""The noiselet operator, and what every operator promises."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.solvers.noiselet import noiselet, noiselet_matrix
from skin.operator import Operator
from skin.phi import sbhe
from tests.reconstructor.helpers import INF, NAN, one_line, spoilt

MAKERS: dict[str, Callable[[int], Operator]] = {
    "sbhe": lambda seed: sbhe(256, 80, block_size=16, selection="uniform", seed=seed),
    "noiselet": lambda seed: noiselet(8, 32, 80, seed=seed),
}


@pytest.mark.parametrize("size", [2, 4, 8, 32, 64, 256])
def test_noiselet_is_a_symmetric_matrix_of_ones(size: int) -> None:
    matrix = noiselet_matrix(size)
    assert np.array_equal(np.abs(matrix), np.ones((size, size)))
    assert np.array_equal(matrix, matrix.T)
    assert np.array_equal(matrix @ matrix, size * np.eye(size))


def haar_functions(size: int) -> np.ndarray:
    """Every Haar wavelet, of unit norm, shape (size - 1, size)."""
    rows = []
    length = size
    while length > 1:
        for start in range(0, size, length):
            row = np.zeros(size)
            row[start : start + length // 2], row[start + length // 2 : start + length] = 1, -1
            rows.append(row / np.sqrt(length))
        length //= 2
    return np.array(rows)


@pytest.mark.parametrize("size", [4, 16, 64, 256])
def test_noiselets_see_every_haar_wavelet_about_alike(size: int) -> None:
    """Why there are noiselets: no sum holds more than √2 times its share of any wavelet; Hadamard's hold √n / 2."""
    assert np.abs(haar_functions(size) @ noiselet_matrix(size)).max() < np.sqrt(2) + 1e-9


@pytest.mark.parametrize("name", MAKERS)
@given(st.integers(0, 2**32 - 1), st.floats(-5, 5))
@settings(max_examples=25, deadline=None)
def test_every_operator_is_linear_and_has_its_adjoint_and_norm(name: str, seed: int, a: float) -> None:
    phi, rng = MAKERS[name](seed), np.random.default_rng(seed)
    (x, v), y = rng.normal(size=(2, phi.shape[1])), rng.normal(size=phi.shape[0])
    assert phi.forward(x) @ y == pytest.approx(x @ phi.adjoint(y), rel=1e-10, abs=1e-9)
    np.testing.assert_allclose(phi.forward(a * x + v), a * phi.forward(x) + phi.forward(v), atol=1e-9)
    np.testing.assert_allclose(phi.forward(phi.adjoint(y)), phi.norm_squared * y, atol=1e-9)
    entries = phi.forward(np.eye(phi.shape[1]))
    assert np.array_equal(entries, entries.astype(np.int8))
    assert phi.forward(x.astype(np.float32)).dtype == phi.adjoint(y.astype(np.float32)).dtype == np.float32


def test_noiselet_is_the_kronecker_product_and_takes_integers_and_batches() -> None:
    phi = noiselet(4, 8, 20, seed=3)
    both = np.kron(noiselet_matrix(4), noiselet_matrix(8))[phi.kept]
    counts = np.random.default_rng(0).integers(0, 1024, (2, 3, 32), dtype=np.uint16)
    assert np.array_equal(phi.forward(counts), counts @ both.T)
    assert np.array_equal(phi.adjoint(phi.forward(counts)), counts @ both.T @ both)


def test_seeds_tell_noiselets_apart() -> None:
    first, again, other = (noiselet(8, 8, 16, seed=seed).kept for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda x: x[:-1], "shape"),
        (lambda x: x.reshape(-1, 1), "shape"),
        (list, "array"),
        (lambda x: x.astype(np.complex128), "complex128"),
        (lambda x: spoilt(x, NAN), "finite"),
        (lambda x: spoilt(x, -INF), "finite"),
    ],
)
def test_vectors_of_a_noiselet(spoil: Callable[[np.ndarray], Any], says: str) -> None:
    one_line(lambda: noiselet(16, 16, 64).forward(spoil(np.ones(256))), says)
    one_line(lambda: noiselet(16, 16, 64).adjoint(spoil(np.ones(64))), says)
