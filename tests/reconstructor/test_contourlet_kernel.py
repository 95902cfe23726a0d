"""The compiled contourlet against the plain one."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstructor.fista import fista
from reconstructor.kernels.contourlet import CompiledContourlet, ContourletSolver
from reconstructor.settings import SolverSettings
from skin.phi import sbhe
from tests.reconstructor.plain_contourlet import PlainContourlet


@pytest.mark.slow  # no service uses the kernels in double precision, and to compile them takes half a minute
@given(st.sampled_from([16, 32, 64, 128]), st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_transforms_are_equal(size: int, seed: int) -> None:
    plain, compiled = PlainContourlet(size, size), CompiledContourlet(size, size)
    rng = np.random.default_rng(seed)
    x, s = rng.normal(size=(size, size)), rng.normal(size=plain.shape)
    np.testing.assert_allclose(compiled.forward(x), plain.forward(x), atol=1e-13)
    np.testing.assert_allclose(compiled.adjoint(s), plain.adjoint(s), atol=1e-13)


@pytest.mark.parametrize(
    ("dtype", "error"), [pytest.param(np.float64, 1e-13, marks=pytest.mark.slow), (np.float32, 1e-6)]
)
def test_solver_is_the_reference_with_rows_deleted(dtype: type, error: float) -> None:
    phi, rng = sbhe(1024, 256, block_size=32, selection="uniform", seed=3), np.random.default_rng(0)
    sums, valid = rng.normal(0, 0.03, 256), rng.random(256) > 0.2

    class Rows:
        shape = (int(valid.sum()), 1024)

        def forward(self, x: np.ndarray) -> Any:
            return phi.forward(x)[valid]

        def adjoint(self, y: np.ndarray) -> Any:
            full = np.zeros(256)
            full[valid] = y
            return phi.adjoint(full)

    solver_settings = SolverSettings(prior="contourlet", iterations=9, penalty_n=0.02, lipschitz_ratio=2.0)
    solver = ContourletSolver(phi, 32, 32, solver_settings, dtype=dtype)
    estimate = solver.new_estimate()
    spoilt = np.where(valid, sums, 1e6).astype(dtype)
    assert solver.solve(estimate, spoilt, valid.astype(dtype), relative_penalty=0.5) == valid.sum()
    psi = PlainContourlet(32, 32)
    reference = fista(Rows(), psi, sums[valid], penalty_n=0.01, lipschitz=solver.lipschitz, iterations=9)
    np.testing.assert_allclose(solver.coefficients_of(estimate), reference, atol=error)
    np.testing.assert_allclose(solver.deliver(estimate), np.maximum(psi.adjoint(reference), 0), atol=max(error, 1e-8))
