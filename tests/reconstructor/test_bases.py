"""Every basis: orthonormal, linear, synthesis the adjoint of analysis; and each against an independent form."""

from collections.abc import Callable

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import InputError
from reconstructor.bases import (
    BASES,
    Basis,
    Pyramid,
    daubechies4_pyramid,
    daubechies4_tensor,
    haar_pyramid,
    haar_tensor,
    make_basis,
)
from reconstructor.bases.separable import wavelet_step, wavelet_tensor

MAKERS = {name: make for name, make in BASES.items() if name != "contourlet"}
sides = st.sampled_from([8, 16, 32, 64])
makers = st.sampled_from(sorted(MAKERS)).map(MAKERS.__getitem__)
Maker = Callable[[int, int], Basis]


@given(makers, sides, sides, st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_orthonormal_and_adjoint(make: Maker, rows: int, columns: int, seed: int) -> None:
    psi = make(rows, columns)
    x, s = np.random.default_rng(seed).normal(size=(2, rows, columns))
    assert psi.image_shape == psi.shape == (rows, columns)
    np.testing.assert_allclose(psi.adjoint(psi.forward(x)), x, atol=1e-12)
    np.testing.assert_allclose(psi.forward(psi.adjoint(s)), s, atol=1e-12)
    assert np.vdot(psi.forward(x), s) == pytest.approx(np.vdot(x, psi.adjoint(s)), abs=1e-9)


@given(makers, st.integers(0, 2**32 - 1), st.floats(-5, 5))
@settings(max_examples=30, deadline=None)
def test_linear_and_leaves_its_argument_alone(make: Maker, seed: int, a: float) -> None:
    psi = make(16, 32)
    u, v = np.random.default_rng(seed).normal(size=(2, 16, 32))
    before = u.copy()
    for apply in (psi.forward, psi.adjoint):
        np.testing.assert_allclose(apply(a * u + v), a * apply(u) + apply(v), atol=1e-11)
    assert np.array_equal(u, before)


@pytest.mark.parametrize("name", sorted(MAKERS))
@pytest.mark.parametrize("shape", [(256, 256), (8, 256)])
def test_largest_grids_and_float32(name: str, shape: tuple[int, int]) -> None:
    psi = MAKERS[name](*shape)
    x = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    back = psi.adjoint(psi.forward(x))
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, x, atol=1e-5)


def test_pyramid_is_that_of_pywavelets() -> None:
    x = np.random.default_rng(0).normal(size=(32, 64))
    levels = pywt.wavedec2(x, "haar", mode="periodization", level=5)
    theirs, _ = pywt.coeffs_to_array(levels)
    np.testing.assert_allclose(haar_pyramid(32, 64).forward(x), theirs, atol=1e-12)


def test_tensor_is_rows_then_columns_of_pywavelets() -> None:
    x = np.random.default_rng(0).normal(size=(16, 64))
    along_rows = np.concatenate(pywt.wavedec(x, "haar", mode="periodization", axis=1), axis=1)
    both = np.concatenate(pywt.wavedec(along_rows, "haar", mode="periodization", axis=0), axis=0)
    np.testing.assert_allclose(haar_tensor(16, 64).forward(x), both, atol=1e-12)


@pytest.mark.parametrize("size", [2, 4, 8, 64])
def test_a_level_of_d4_starts_at_sample_2k_and_wraps_round(size: int) -> None:
    """Against the taps of Daubechies (1988) as they are printed."""
    root = 3**0.5
    low = np.array([1 + root, 3 + root, 3 - root, 1 - root]) / (4 * 2**0.5)
    high = low[::-1] * [1, -1, 1, -1]
    x = np.random.default_rng(0).normal(size=size)
    taken = x[(2 * np.arange(size // 2)[:, None] + np.arange(4)) % size]
    made = wavelet_step(pywt.Wavelet("db2"), size) @ x
    np.testing.assert_allclose(made, np.concatenate((taken @ low, taken @ high)), atol=1e-14)


@pytest.mark.parametrize("name", ["db3", "db10", "sym4", "coif2"])
def test_other_wavelets_of_pywavelets_are_orthonormal_bases_too(name: str) -> None:
    wavelet, x = pywt.Wavelet(name), np.random.default_rng(0).normal(size=(16, 32))
    for psi in (wavelet_tensor(wavelet, 16, 32), Pyramid(16, 32, wavelet)):
        np.testing.assert_allclose(psi.adjoint(psi.forward(x)), x, atol=1e-9)
        assert np.linalg.norm(psi.forward(x)) == pytest.approx(np.linalg.norm(x))


def test_d4_pyramid_starts_like_the_tensor_and_goes_on_with_the_low_quadrant() -> None:
    x = np.random.default_rng(0).normal(size=(64, 64))
    pyramid, tensor = daubechies4_pyramid(64, 64).forward(x), daubechies4_tensor(64, 64).forward(x)
    np.testing.assert_allclose(pyramid[32:, 32:], tensor[32:, 32:], atol=1e-12)
    assert not np.allclose(pyramid[32:, :32], tensor[32:, :32])
    flat = np.abs(pyramid).ravel()
    assert flat @ flat == pytest.approx(np.vdot(x, x))


def test_d4_kills_straight_lines_away_from_the_edge() -> None:
    ramp = np.tile(np.arange(64.0), (64, 1))
    finest = daubechies4_tensor(64, 64).columns_matrix[32:] @ ramp[0]
    np.testing.assert_allclose(finest[:-1], 0, atol=1e-12)  # the last filter wraps round
    assert abs(finest[-1]) > 1


def test_constant_is_one_coefficient_of_every_basis() -> None:
    for make in MAKERS.values():
        s = make(32, 32).forward(np.ones((32, 32)))
        assert s[0, 0] == pytest.approx(32)
        assert np.abs(s).sum() == pytest.approx(32, abs=1e-9)


@pytest.mark.parametrize("name", sorted(MAKERS))
@pytest.mark.parametrize("shape", [(60, 64), (4, 64), (64, 512)])
def test_other_grids_are_refused(name: str, shape: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="powers of two"):
        MAKERS[name](*shape)


def test_unknown_names_are_told() -> None:
    with pytest.raises(InputError, match="unknown basis 'db9': expected one of haar-tensor"):
        make_basis("db9", 64, 64)
