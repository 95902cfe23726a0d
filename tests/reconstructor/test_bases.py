"""Every basis: orthonormal, linear, synthesis the adjoint of analysis; and each against an independent form."""

import warnings

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import InputError
from reconstructor.bases import wavelet_basis
from reconstructor.bases.names import FORMS, orthogonal_wavelets, wavelet_basis_name
from reconstructor.bases.wavelets import wavelet_step

NAMES = ("haar-tensor", "haar-pyramid", "d4-tensor", "d4-pyramid")
sides = st.sampled_from([8, 16, 32, 64])
names = st.sampled_from(NAMES)


@pytest.mark.heavy
@given(names, sides, sides, st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_orthonormal_and_adjoint(name: str, rows: int, columns: int, seed: int) -> None:
    psi = wavelet_basis(name, rows, columns)
    x, s = np.random.default_rng(seed).normal(size=(2, rows, columns))
    before = x.copy()
    assert psi.image_shape == psi.shape == (rows, columns)
    np.testing.assert_allclose(psi.adjoint(psi.forward(x)), x, atol=1e-12)
    np.testing.assert_allclose(psi.forward(psi.adjoint(s)), s, atol=1e-12)
    assert np.vdot(psi.forward(x), s) == pytest.approx(np.vdot(x, psi.adjoint(s)), abs=1e-9)
    np.testing.assert_array_equal(x, before)


def test_pyramid_is_that_of_pywavelets() -> None:
    x = np.random.default_rng(0).normal(size=(32, 64))
    levels = pywt.wavedec2(x, "haar", mode="periodization", level=5)
    theirs, _ = pywt.coeffs_to_array(levels)
    np.testing.assert_allclose(wavelet_basis("haar-pyramid", 32, 64).forward(x), theirs, atol=1e-12)


def test_tensor_is_rows_then_columns_of_pywavelets() -> None:
    x = np.random.default_rng(0).normal(size=(16, 64))
    along_rows = np.concatenate(pywt.wavedec(x, "haar", mode="periodization", axis=1), axis=1)
    both = np.concatenate(pywt.wavedec(along_rows, "haar", mode="periodization", axis=0), axis=0)
    np.testing.assert_allclose(wavelet_basis("haar-tensor", 16, 64).forward(x), both, atol=1e-12)


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


@pytest.mark.parametrize("name", [each for each in orthogonal_wavelets() if each not in {"db1", "db2"}])
def test_every_orthogonal_wavelet_is_a_basis_and_that_of_pywavelets(name: str) -> None:
    """The image of PyWavelets is shifted by half a filter less 1: there a level starts before sample 2k."""
    x, s = np.random.default_rng(0).normal(size=(2, 16, 32))
    shift = pywt.Wavelet(name).dec_len // 2 - 1
    with warnings.catch_warnings(action="ignore"):  # filters longer than the image
        levels = pywt.wavedec2(np.roll(x, (shift, shift), axis=(0, 1)), name, mode="periodization", level=4)
    theirs, _ = pywt.coeffs_to_array(levels)
    pyramid = wavelet_basis(f"{name}-pyramid", 16, 32).forward(x)
    for height in (1, 2, 4, 8):
        for band in np.s_[height : 2 * height, : 2 * height], np.s_[:height, 2 * height : 4 * height]:
            np.testing.assert_allclose(np.sort(pyramid[band], axis=None), np.sort(theirs[band], axis=None), atol=1e-9)
    for form in FORMS:
        psi = wavelet_basis(f"{name}-{form}", 16, 32)
        np.testing.assert_allclose(psi.adjoint(psi.forward(x)), x, atol=1e-9)
        assert np.vdot(psi.forward(x), s) == pytest.approx(np.vdot(x, psi.adjoint(s)), abs=1e-9)
        assert np.linalg.norm(psi.forward(x)) == pytest.approx(np.linalg.norm(x))


@pytest.mark.parametrize(
    ("name", "full"),
    [("haar", "haar-pyramid"), ("db1", "haar-pyramid"), ("db2-tensor", "d4-tensor"), ("sym4", "sym4-pyramid")],
)
def test_a_wavelet_has_one_full_name(name: str, full: str) -> None:
    assert wavelet_basis_name(name) == full == wavelet_basis_name(full)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("sym44", "unknown basis 'sym44': did you mean 'sym4'[?] expected .* coif1 to coif17, db1 to db38, haar, sym2"),
        ("SYM4", "did you mean 'sym4'"),
        ("sym4-pyramids", "unknown basis 'sym4-pyramids': did you mean 'sym4'"),
        ("bior2.2", "'bior2.2' is not orthogonal: expected an orthogonal wavelet"),
        ("dmey-tensor", "'dmey-tensor' is not orthogonal"),
        ("", "unknown basis ''"),
    ],
)
def test_unknown_names_are_told(name: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        wavelet_basis(name, 64, 64)
