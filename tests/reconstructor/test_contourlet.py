"""The contourlet against the toolbox, its own adjoint, and the numbers its literature gives."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.reconstructor.plain_contourlet import PlainContourlet


@pytest.mark.heavy
@given(st.sampled_from([16, 32, 64, 128]), st.integers(0, 2**32 - 1), st.floats(-3, 3))
@settings(max_examples=15, deadline=None)
def test_perfect_reconstruction_adjoint_and_linearity(size: int, seed: int, a: float) -> None:
    psi, rng = PlainContourlet(size, size), np.random.default_rng(seed)
    x, v = rng.normal(size=(2, size, size))
    s, t = rng.normal(size=(2, *psi.shape))
    assert psi.shape == (5 * size * size // 4,)
    np.testing.assert_allclose(psi.adjoint(psi.analyse(x)), x, atol=1e-12)
    assert psi.forward(x) @ s == pytest.approx(np.vdot(x, psi.adjoint(s)), rel=1e-10, abs=1e-9)
    np.testing.assert_allclose(psi.forward(a * x + v), a * psi.forward(x) + psi.forward(v), atol=1e-10)
    np.testing.assert_allclose(psi.adjoint(a * s + t), a * psi.adjoint(s) + psi.adjoint(t), atol=1e-10)


def test_equals_the_matlab_toolbox() -> None:
    """Its output for an image of random numbers, where SKIN_DATA has it."""
    if "SKIN_DATA" not in os.environ:
        pytest.skip("NOT TESTED: the contourlet beside the toolbox's full output, for want of SKIN_DATA")
    with np.load(Path(os.environ["SKIN_DATA"], "contourlet-vectors", "pdfbdec_64x64_nlevs5.npz")) as vectors:
        np.testing.assert_allclose(PlainContourlet(64, 64).analyse(vectors["x"]), vectors["pkva"], atol=1e-12)


#: Coefficients of sin(1 + 3i + ij / 10) at eight places, taken when the code equalled the toolbox to 5e-15.
GOLDEN = [0.876652195, -0.00425526, 0.203957467, -0.263580591, -4.623122189, 0.41906467, -0.783848659, -2.386151518]


def test_golden_coefficients() -> None:
    i, j = np.indices((64, 64))
    s = PlainContourlet(64, 64).analyse(np.sin(1 + 3 * i + 0.1 * i * j))
    np.testing.assert_allclose(s[[0, 517, 1023, 1024, 2000, 3071, 3072, 5119]], GOLDEN, atol=1e-8)
