"""Basis pursuit solves what it says."""

import numpy as np
import pytest
from scipy.optimize import linprog

from canskin.errors import InputError
from evaluation.solvers.pursuit import basis_pursuit
from reconstructor.kernels.contourlet import CompiledContourlet
from tests.reconstructor.helpers import ball


@pytest.mark.slow
def test_basis_pursuit_is_the_linear_programme() -> None:
    psi, image = CompiledContourlet(16, 16), ball(0, 0, 0.01)[24:40, 24:40]
    matrix = np.stack([psi.adjoint(row).ravel() for row in np.eye(320)], axis=1)
    answer = linprog(np.ones(640), A_eq=np.hstack((matrix, -matrix)), b_eq=image.ravel(), method="highs-ipm")
    s = basis_pursuit(psi, image, relative_error=5e-3)
    assert np.abs(s).sum() == pytest.approx(answer.fun, rel=1e-2)
    np.testing.assert_allclose(psi.adjoint(s), image, atol=5e-3 * np.linalg.norm(image))


@pytest.mark.slow
def test_golf_ball_has_the_sparsity_of_table_i() -> None:
    """At full depth, |s| > 0.001: 23 at most and 17.4 on average over the trajectory."""
    s = basis_pursuit(CompiledContourlet(64, 64), ball(0.01, 0.02, 0.00999), relative_error=1e-2)
    assert 14 <= np.count_nonzero(np.abs(s) > 0.001) <= 27


@pytest.mark.slow
def test_basis_pursuit_gives_up_plainly() -> None:
    psi = CompiledContourlet(16, 16)
    assert not basis_pursuit(psi, np.zeros((16, 16))).any()
    with pytest.raises(InputError, match="did not converge in 20"):
        basis_pursuit(psi, np.random.default_rng(0).normal(size=(16, 16)), iterations=20)
