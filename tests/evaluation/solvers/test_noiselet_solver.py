"""The compiled noiselet solvers against the plain FISTA."""

from typing import Any

import numpy as np
import pytest

from evaluation.solvers.noiselet import noiselet
from evaluation.solvers.noiselet_solver import NoiseletSolver
from reconstructor.bases import wavelet_basis
from reconstructor.fista import fista
from reconstructor.settings import SolverSettings
from tests.reconstructor.plain_contourlet import PlainContourlet


@pytest.mark.parametrize(
    ("prior", "columns"),
    [("haar-tensor", 16), ("haar-tensor", 32), pytest.param("contourlet", 32, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize(("dtype", "error"), [(np.float64, 1e-13), (np.float32, 1e-6)])
def test_solver_is_the_reference_with_rows_deleted(prior: Any, columns: int, dtype: type, error: float) -> None:
    phi, rng = noiselet(32, columns, 200, seed=3), np.random.default_rng(0)
    sums, valid = rng.normal(0, 0.3, 200), rng.random(200) > 0.2
    settings = SolverSettings(prior=prior, iterations=9, penalty_n=2.0, lipschitz_ratio=2.0)
    solver = NoiseletSolver(phi, settings, dtype=dtype)
    estimate = solver.new_estimate()
    spoilt = np.where(valid, sums, 1e6).astype(dtype)
    assert solver.solve(estimate, spoilt, valid.astype(dtype)) == valid.sum()
    rows = type(phi)(32, columns, phi.kept[valid])
    psi = PlainContourlet(32, columns) if prior == "contourlet" else wavelet_basis(prior, 32, columns)
    expected = fista(rows, psi, sums[valid], penalty_n=2.0, lipschitz=solver.lipschitz, iterations=9)
    assert np.count_nonzero(expected) < expected.size / 2
    np.testing.assert_allclose(solver.deliver(estimate), np.maximum(psi.adjoint(expected), 0), atol=max(error, 1e-8))
