"""The reference solver: it minimises what it says it minimises."""

from types import ModuleType
from typing import Any

import array_api_strict
import numpy as np
import pytest

from reconstructor.bases import WaveletBasis, wavelet_basis
from reconstructor.fista import fista, iterate, largest_eigenvalue, momentum, objective, soft
from skin.phi import sbhe
from tests.reconstructor.reference import Shrinkage, Variation, fista_image

PHI = sbhe(256, 64, block_size=16, seed=3)
SUMS = np.random.default_rng(0).normal(0, 0.02, 64)
PENALTY_N = 0.01


def test_momentum_is_that_of_beck_and_teboulle() -> None:
    np.testing.assert_allclose(momentum(3), [0, 0.28175, 0.43404], atol=5e-6)  # t = 1, 1.61803, 2.19353, 2.74979


def test_soft_threshold() -> None:
    np.testing.assert_array_equal(soft(np.array([-3.0, -1.0, 0.5, 2.0]), 1.0), [-2, 0, 0, 1])


@pytest.mark.heavy
@pytest.mark.parametrize(
    "psi",
    [
        wavelet_basis("haar-pyramid", 16, 16),
        wavelet_basis("haar-tensor", 16, 16),
        wavelet_basis("d4-tensor", 16, 16),
    ],
)
def test_reaches_the_minimum(psi: WaveletBasis) -> None:
    """Optimality of the lasso: correlations with the residual are λ·sign(s) where s ≠ 0, and at most λ elsewhere."""
    s = fista(PHI, psi, SUMS, penalty_n=PENALTY_N, lipschitz=16, iterations=3000)
    residual = SUMS - PHI.forward(psi.adjoint(s).reshape(-1))
    correlation = psi.forward(PHI.adjoint(residual).reshape(16, 16))
    support = np.abs(s) > 1e-9
    assert support.any()
    np.testing.assert_allclose(correlation[support], PENALTY_N * np.sign(s[support]), atol=1e-7)
    assert np.abs(correlation).max() <= PENALTY_N * (1 + 1e-6)


@pytest.mark.heavy
def test_objective_falls_towards_a_long_run_and_observers_see_it() -> None:
    psi = wavelet_basis("haar-pyramid", 16, 16)
    seen: list[float] = []

    def observe(k: int, s: np.ndarray) -> None:
        assert k == len(seen) + 1
        seen.append(objective(PHI, psi, SUMS, s, PENALTY_N))

    fista(PHI, psi, SUMS, penalty_n=PENALTY_N, lipschitz=16, iterations=2000, observe=observe)
    best = min(seen)
    assert seen[-1] == pytest.approx(best, rel=1e-9)
    for k in (5, 10, 20, 40):
        # Theorem 4.4 of Beck and Teboulle, with ‖s*‖² generously from above.
        assert seen[k - 1] - best <= 2 * 16 * np.sum((SUMS / 4) ** 2) / (k + 1) ** 2
    assert seen[19] - best < 0.1 * (seen[0] - best)


def test_the_loop_runs_on_any_library_of_the_array_standard() -> None:
    """`array_api_strict` allows the standard alone: what runs on it runs on PyTorch and CuPy, too."""
    matrix, sums = np.random.default_rng(1).normal(size=(8, 20)), np.random.default_rng(2).normal(size=(8, 1))
    step = 1 / float(np.linalg.eigvalsh(matrix @ matrix.T).max())

    def solved(xp: ModuleType) -> Any:
        phi, y = xp.asarray(matrix), xp.asarray(sums)
        return iterate(
            xp.zeros((20, 1), dtype=xp.float64),
            lambda ahead: step * xp.matmul(phi.T, xp.matmul(phi, ahead) - y),
            lambda made, _iteration: soft(made, xp.asarray(0.1 * step), xp),
            momentum(30).tolist(),
        )

    expected = solved(np)
    assert 0 < np.count_nonzero(expected) < 20
    np.testing.assert_allclose(np.asarray(solved(array_api_strict)), expected, atol=1e-15)


def test_image_form_is_the_coefficient_form() -> None:
    psi = wavelet_basis("haar-tensor", 16, 16)
    s = fista(PHI, psi, SUMS, penalty_n=PENALTY_N, lipschitz=32, iterations=20)
    x = fista_image(
        PHI, Shrinkage(psi), SUMS, penalty_n=PENALTY_N, lipschitz=32, iterations=20, start=np.zeros((16, 16))
    )
    np.testing.assert_allclose(x, psi.adjoint(s), atol=1e-14)


def test_variation_is_the_proximal_step_when_it_has_time() -> None:
    """No small change of the result lowers what it minimises, and what it minimises is below the image's."""
    rng = np.random.default_rng(4)
    image = rng.normal(0.2, 1, (8, 8))
    found = Variation((8, 8), 3000)(image, 0.5, 0)

    def value(u: np.ndarray) -> float:
        return 0.5 * np.sum((u - image) ** 2) + 0.5 * (np.abs(np.diff(u, axis=0)).sum() + np.abs(np.diff(u)).sum())

    assert found.min() >= 0
    assert value(found) < value(np.maximum(image, 0))
    for _ in range(200):
        moved = np.maximum(found + rng.normal(0, 0.01, (8, 8)) * (rng.random((8, 8)) < 0.2), 0)
        assert value(moved) >= value(found) - 1e-9


@pytest.mark.heavy
def test_largest_eigenvalue() -> None:
    exact = largest_eigenvalue(PHI, wavelet_basis("haar-tensor", 16, 16))
    assert exact == pytest.approx(16, rel=2e-4)
    first, second = wavelet_basis("haar-tensor", 16, 16), wavelet_basis("d4-tensor", 16, 16)

    class Both:
        """Two bases side by side: neither tight nor orthogonal where the second counts half."""

        shape, image_shape = (512,), (16, 16)

        def forward(self, image: np.ndarray) -> np.ndarray:
            return np.concatenate((first.forward(image).ravel(), 0.5 * second.forward(image[::-1]).ravel()))

        def adjoint(self, s: np.ndarray) -> np.ndarray:
            halves = s.reshape(2, 16, 16)
            return first.adjoint(halves[0]) + 0.5 * second.adjoint(halves[1])[::-1]

    psi = Both()
    dense = np.stack([PHI.forward(psi.adjoint(row).ravel()) for row in np.eye(512)], axis=1)
    largest = np.linalg.eigvalsh(dense @ dense.T).max()
    assert largest <= largest_eigenvalue(PHI, psi) <= largest * 1.0005
