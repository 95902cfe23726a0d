"""ADMM, smoothed L0 and basis pursuit: they solve what they say, and agree with FISTA where they must."""

import numpy as np
import pytest
from scipy.optimize import linprog

from canskin.errors import InputError
from evaluation.solvers.baselines import admm, smoothed_l0
from evaluation.solvers.noiselet import noiselet
from evaluation.solvers.pursuit import basis_pursuit
from reconstructor.bases import wavelet_basis
from reconstructor.fista import fista, largest_eigenvalue, objective
from reconstructor.kernels.contourlet import CompiledContourlet
from skin.measurement import sbhe
from tests.reconstructor.helpers import ball
from tests.reconstructor.plain_contourlet import PlainContourlet

PHI = sbhe(256, 64, block_size=16, seed=3)
NOISELET = noiselet(16, 16, 64, seed=3)


def sparse_image(psi: object, count: int = 10) -> np.ndarray:
    rng = np.random.default_rng(5)
    s = np.zeros((16, 16))
    s.flat[rng.permutation(256)[:count]] = rng.choice((-1, 1), count) * rng.uniform(0.005, 0.02, count)
    return s


@pytest.mark.heavy
@pytest.mark.parametrize("phi", [PHI, NOISELET])
def test_admm_and_fista_find_the_same_minimum(phi: object) -> None:
    psi, penalty_n = wavelet_basis("haar-pyramid", 16, 16), 0.01 * phi.norm_squared / 16
    sums = phi.forward(psi.adjoint(sparse_image(psi)).ravel()) + np.random.default_rng(0).normal(0, 0.002, 64)
    seen: list[int] = []
    theirs = admm(
        phi,
        psi,
        sums,
        penalty_n=penalty_n,
        iterations=1500,
        coupling=phi.norm_squared / 10,
        observe=lambda k, _: seen.append(k),
    )
    ours = fista(phi, psi, sums, penalty_n=penalty_n, lipschitz=phi.norm_squared, iterations=3000)
    values = [objective(phi, psi, sums, s, penalty_n) for s in (theirs, ours)]
    assert values[0] == pytest.approx(values[1], rel=1e-6)
    np.testing.assert_allclose(theirs, ours, atol=1e-5)
    assert seen == list(range(1, 1501))


@pytest.mark.parametrize("psi", [wavelet_basis("haar-tensor", 16, 16), wavelet_basis("d4-pyramid", 16, 16)])
def test_smoothed_l0_finds_a_sparse_image_from_a_quarter_of_its_sums(psi: object) -> None:
    s = sparse_image(psi)
    found = smoothed_l0(
        NOISELET, psi, NOISELET.forward(psi.adjoint(s).ravel()), tolerance_n=0, smallest_n=1e-5, shrink=0.9, inner=10
    )
    np.testing.assert_allclose(found, s, atol=1e-4)


def test_smoothed_l0_leaves_the_noise_unexplained() -> None:
    psi = wavelet_basis("haar-tensor", 16, 16)
    noise = np.random.default_rng(1).normal(0, 0.005, 64)
    sums = NOISELET.forward(psi.adjoint(sparse_image(psi)).ravel()) + noise
    tolerance = float(np.linalg.norm(noise))
    found = smoothed_l0(NOISELET, psi, sums, tolerance_n=tolerance, smallest_n=5e-4, shrink=0.9, inner=10)
    assert np.linalg.norm(NOISELET.forward(psi.adjoint(found).ravel()) - sums) <= tolerance * (1 + 1e-9)
    np.testing.assert_allclose(found, sparse_image(psi), atol=0.004)


@pytest.mark.heavy
def test_largest_eigenvalue() -> None:
    exact = largest_eigenvalue(PHI, wavelet_basis("haar-tensor", 16, 16))
    assert exact == pytest.approx(16, rel=2e-4)
    psi = PlainContourlet(16, 16)
    dense = np.stack([PHI.forward(psi.adjoint(row).ravel()) for row in np.eye(320)], axis=1)
    largest = np.linalg.eigvalsh(dense @ dense.T).max()
    assert largest <= largest_eigenvalue(PHI, psi) <= largest * 1.0005


@pytest.mark.slow
def test_basis_pursuit_is_the_linear_programme() -> None:
    psi, image = PlainContourlet(16, 16), ball(0, 0, 0.01)[24:40, 24:40]
    matrix = np.stack([psi.adjoint(row).ravel() for row in np.eye(320)], axis=1)
    answer = linprog(np.ones(640), A_eq=np.hstack((matrix, -matrix)), b_eq=image.ravel(), method="highs-ipm")
    s = basis_pursuit(CompiledContourlet(16, 16), image, relative_error=5e-3)
    assert np.abs(s).sum() == pytest.approx(answer.fun, rel=1e-2)
    np.testing.assert_allclose(psi.adjoint(s), image, atol=5e-3 * np.linalg.norm(image))
    assert np.abs(s).sum() < 0.97 * np.abs(psi.analyse(image)).sum()


@pytest.mark.slow
def test_golf_ball_has_the_sparsity_of_table_i() -> None:
    """At full depth, |s| > 0.001: 23 at most and 17.4 on average over the trajectory."""
    s = basis_pursuit(CompiledContourlet(64, 64), ball(0.01, 0.02, 0.00999), relative_error=1e-2)
    assert 14 <= np.count_nonzero(np.abs(s) > 0.001) <= 27


@pytest.mark.heavy
def test_basis_pursuit_gives_up_plainly() -> None:
    psi = PlainContourlet(16, 16)
    assert not basis_pursuit(psi, np.zeros((16, 16))).any()
    with pytest.raises(InputError, match="did not converge in 20"):
        basis_pursuit(psi, np.random.default_rng(0).normal(size=(16, 16)), iterations=20)
