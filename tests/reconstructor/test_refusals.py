"""Everything that cannot be computed is refused: one line that says what was expected and what came."""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from reconstructor.bases import wavelet_basis
from reconstructor.engine import Reconstructor
from reconstructor.fista import fista, largest_eigenvalue, objective
from reconstructor.kernels.contourlet import CompiledContourlet, ContourletSolver
from reconstructor.kernels.haar import HaarSolver
from reconstructor.kernels.variation import VariationSolver
from reconstructor.settings import SolverSettings
from reconstructor.wavelet_solver import WaveletSolver
from skin.phi import sbhe
from tests.reconstructor.helpers import INF, NAN, one_line, spoilt

PHI = sbhe(256, 64, block_size=16, seed=3)
BASES = ("haar-tensor", "haar-pyramid", "d4-tensor", "d4-pyramid")
#: A measurement operator of another kind.
OTHER: Any = SimpleNamespace(shape=(64, 256), dtype=np.dtype(np.int8))
PSI = wavelet_basis("haar-tensor", 16, 16)
SUMS = np.random.default_rng(0).normal(0, 0.02, 64)
ONES = np.ones(64)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda x: x[:-1], "shape"),
        (lambda x: x.reshape(-1, 1), "shape"),
        (list, "array"),
        (lambda x: x.astype(object), "object"),
        (lambda x: spoilt(x, NAN), "finite"),
        (lambda x: spoilt(x, -INF), "finite"),
    ],
)
def test_measurement_operators(spoil: Callable[[np.ndarray], Any], says: str) -> None:
    one_line(lambda: PHI.forward(spoil(np.ones(256))), says)
    one_line(lambda: PHI.adjoint(spoil(np.ones(64))), says)


@pytest.mark.parametrize(
    "valid", [np.ones(15, np.bool_), np.ones(17, np.bool_), np.ones(16), np.ones((16, 1), np.bool_)]
)
def test_validity_of_blocks(valid: np.ndarray) -> None:
    one_line(lambda: PHI.sums_of_blocks(valid), "expected 16 booleans, one a block")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: sbhe(256, 0), "1 to 256 sums"),
        (lambda: sbhe(256, 257), "1 to 256 sums"),
        (lambda: sbhe(0, 0), "one taxel or more"),
        (lambda: sbhe(256, 64, block_size=-32), "power of two"),
        (lambda: sbhe(256, 64, block_size=24), "power of two"),
        (lambda: sbhe(256, 65), "multiple of 8 blocks"),
        (lambda: sbhe(256, 64, selection="every"), "balanced or uniform"),  # type: ignore[arg-type]
        (lambda: sbhe(256, 64, seed=-1), "seed"),
        (lambda: sbhe(256.0, 64), "whole numbers"),  # type: ignore[arg-type]
    ],
)
def test_sizes_of_measurement_operators(make: Callable[[], Any], says: str) -> None:
    one_line(make, says)


@pytest.mark.parametrize(
    "psi",
    [*(wavelet_basis(name, 16, 16) for name in BASES), CompiledContourlet(16, 16)],
    ids=[*BASES, "compiled contourlet"],
)
@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda x: x[:-1], "expected an array of float32 or float64 of shape"),
        (list, "got list"),
        (lambda x: x.astype(np.float16), "got float16"),
        (lambda x: spoilt(x, NAN), "finite numbers"),
    ],
)
def test_bases(psi: Any, spoil: Callable[[np.ndarray], Any], says: str) -> None:
    one_line(lambda: psi.forward(spoil(np.ones((16, 16)))), says)
    one_line(lambda: psi.adjoint(spoil(np.ones(psi.shape))), says)


@pytest.mark.parametrize("make", [*(partial(wavelet_basis, name) for name in BASES), CompiledContourlet])
@pytest.mark.parametrize("grid", [(-16, -16), (12, 12), (4, 4), (512, 512), (16.0, 16.0)])
def test_grids(make: Callable[..., Any], grid: tuple[Any, Any]) -> None:
    one_line(lambda: make(*grid), "power(s)? of two, (8|16) to 256")


@pytest.mark.parametrize("grid", [(16, 32), (8, 8)])
def test_contourlet_takes_squares_from_16(grid: tuple[int, int]) -> None:
    one_line(lambda: CompiledContourlet(*grid), "square")


FISTA: dict[str, Any] = {"sums_n": SUMS, "penalty_n": 0.01, "lipschitz": 16.0, "iterations": 3}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"sums_n": SUMS[:-1]}, "sums: .*shape"),
        ({"sums_n": np.float64(0.1)}, "sums: .*float64"),
        ({"sums_n": np.ones(64, np.int64)}, "got int64"),
        ({"sums_n": spoilt(SUMS, NAN)}, "sums: .*finite"),
        ({"start": np.zeros((16, 8))}, "start"),
        ({"start": spoilt(np.zeros((16, 16)), INF)}, "start: .*finite"),
        ({"penalty_n": -0.01}, "penalty"),
        ({"penalty_n": NAN}, "penalty"),
        ({"iterations": 0}, "at least 1 iteration"),
        ({"iterations": 2.5}, "at least 1 iteration"),
    ],
)
def test_plain_solver(changed: dict[str, Any], says: str) -> None:
    one_line(lambda: fista(PHI, PSI, **{**FISTA, **changed}), says)


@pytest.mark.parametrize("value", [0.0, -16.0, NAN, INF])
def test_steps(value: float) -> None:
    one_line(lambda: fista(PHI, PSI, **{**FISTA, "lipschitz": value}), "L needs a number above 0")


def test_other_functions_of_the_plain_solvers() -> None:
    wide = wavelet_basis("haar-tensor", 16, 32)
    for call in (
        lambda: fista(PHI, wide, **FISTA),
        lambda: largest_eigenvalue(PHI, wide),
        lambda: objective(PHI, wide, SUMS, np.zeros((16, 32)), 0.01),
    ):
        one_line(call, "256 taxels but the image of Ψ has 512")
    one_line(lambda: objective(PHI, PSI, SUMS, np.zeros(256), 0.01), "start: .*shape")


def settings(prior: str = "haar-tensor", **changed: Any) -> SolverSettings:
    return SolverSettings(**{"prior": prior, "iterations": 3, "penalty_n": 0.01, **changed})


SOLVERS: dict[str, tuple[Callable[..., Any], tuple[int, ...]]] = {
    "haar": (lambda **o: HaarSolver(PHI, 16, 16, settings("haar-pyramid"), **o), (64,)),
    "variation": (lambda **o: VariationSolver(PHI, 16, 16, settings("variation"), **o), (64,)),
    "contourlet": (lambda **o: ContourletSolver(PHI, 16, 16, settings("contourlet"), **o), (64,)),
    "wavelets": (lambda **o: WaveletSolver(PHI, 16, 16, settings(), **o), (64,)),
}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"iterations": 0}, "at least 1 iteration"),
        ({"iterations": 1.5}, "at least 1 iteration"),
        ({"iterations": 10**9}, "at most 100000 iterations"),
        ({"penalty_n": -1e-9}, "penalty"),
        ({"penalty_n": NAN}, "penalty"),
        ({"penalty_n": INF}, "penalty"),
        ({"lipschitz_ratio": 0.99}, "diverges"),
        ({"lipschitz_ratio": NAN}, "diverges"),
        ({"prior": "fourier"}, "unknown basis 'fourier': expected an orthogonal wavelet"),
        ({"prior": "sym4"}, "expected the full name 'sym4-pyramid'"),
        ({"spins": 0}, "1 to 64 spins"),
        ({"spins": 65}, "1 to 64 spins"),
        ({"spins": 2.0}, "1 to 64 spins"),
        ({"prior": "variation", "spins": 2}, "no wavelet basis to shift"),
        ({"prior": "contourlet", "spins": 2}, "no wavelet basis to shift"),
        ({"prior": "contourlet", "nonnegative": True}, "neither nonnegative nor scaled_start"),
        ({"prior": "contourlet", "scaled_start": True}, "neither nonnegative nor scaled_start"),
    ],
)
def test_settings_of_solvers(changed: dict[str, Any], says: str) -> None:
    one_line(lambda: settings(**changed), says)


@pytest.mark.parametrize("kind", SOLVERS)
@pytest.mark.parametrize("dtype", [np.int32, np.float16, "single precision"])
def test_dtypes_of_solvers(kind: str, dtype: Any) -> None:
    name = dtype if isinstance(dtype, str) else np.dtype(dtype).name
    one_line(lambda: SOLVERS[kind][0](dtype=dtype), f"float32 or float64, got {name}")


@pytest.mark.parametrize(
    ("solver", "refused", "says"),
    [
        (HaarSolver, settings("contourlet"), "expected one of haar-pyramid, haar-tensor, got 'contourlet'"),
        (ContourletSolver, settings("variation"), "expected the prior 'contourlet', got 'variation'"),
    ],
)
def test_solvers_refuse_settings_of_others(solver: Any, refused: SolverSettings, says: str) -> None:
    one_line(lambda: solver(PHI, 16, 16, refused), says)


def test_compiled_solvers_take_an_sbhe_alone() -> None:
    for make in (
        lambda: HaarSolver(OTHER, 16, 16, settings()),
        lambda: ContourletSolver(OTHER, 16, 16, settings("contourlet")),
        lambda: WaveletSolver(OTHER, 16, 16, settings()),
        lambda: Reconstructor(OTHER, 16, 16),
    ):
        one_line(make, "needs an SBHE, got SimpleNamespace")


@pytest.mark.parametrize("kind", SOLVERS)
@pytest.mark.parametrize(
    ("place", "spoil", "says"),
    [
        (0, lambda x: x[:-1], "estimate: .*shape"),
        (0, lambda x: x.astype(np.float32), "estimate: .*float32"),
        (0, lambda x: np.repeat(x, 2, axis=-1)[..., ::2], "estimate: expected contiguous, writeable"),
        (0, lambda x: np.broadcast_to(x, x.shape), "estimate: expected contiguous, writeable"),
        (1, lambda x: x[..., :-1], "sums: .*shape"),
        (1, lambda x: x.astype(np.float32), "sums: .*float32"),
        (1, lambda x: spoilt(x, NAN), "sums of at most 1e6 N"),
        (1, lambda x: spoilt(x, 1e30), "sums of at most 1e6 N"),
        (2, lambda x: x[..., :-1], "weights: .*shape"),
        (2, lambda x: x > 0, "weights: .*bool"),
        (2, lambda x: spoilt(x, 1.5), "weights of 0 to 1"),
        (2, lambda x: spoilt(x, -0.1), "weights of 0 to 1"),
    ],
)
def test_arrays_of_solvers(kind: str, place: int, spoil: Callable[[np.ndarray], Any], says: str) -> None:
    make, shape = SOLVERS[kind]
    solver = make(dtype=np.float64)
    rng = np.random.default_rng(0)
    given = [solver.new_estimate(), rng.normal(0, 0.02, shape), np.ones(shape)]
    solver.solve(*given)
    before = given[0].copy()
    wrong = [*given]
    wrong[place] = spoil(given[place])
    one_line(lambda: solver.solve(*wrong), says)
    np.testing.assert_array_equal(given[0], before)
    one_line(lambda: solver.deliver(before[:-1]), "estimate: .*shape")
    one_line(lambda: solver.solve(*given, relative_penalty=-1), "relative penalty")
    one_line(lambda: solver.solve(*given, relative_penalty=NAN), "relative penalty")


def test_images_and_coefficients_of_compiled_solvers() -> None:
    haar = HaarSolver(PHI, 16, 16, settings())
    contourlet = ContourletSolver(PHI, 16, 16, settings("contourlet"))
    one_line(lambda: haar.blocks_of(np.zeros(256)), "image: .*shape")
    one_line(lambda: haar.image_of(np.zeros(255)), "estimate: .*shape")
    one_line(lambda: contourlet.estimate_of(np.zeros(256)), "coefficients: .*shape")
    one_line(lambda: contourlet.coefficients_of(np.zeros(256)), "estimate: .*shape")


@pytest.mark.parametrize(
    ("sums", "valid", "says"),
    [
        (SUMS[:-1], ONES > 0, "64 sums"),
        (SUMS, ONES[:-1] > 0, "64 sums"),
        (SUMS[None], ONES > 0, "64 sums"),
        (list(SUMS), ONES > 0, "expected arrays, got list"),
        (SUMS, ONES, "floats and bools, got float64 and float64"),
        (SUMS.astype(np.complex64), ONES > 0, "got complex64"),
        (spoilt(SUMS, NAN), ONES > 0, "not finite"),
        (spoilt(SUMS, -1e300), ONES > 0, "above 1e6"),
    ],
)
def test_reconstructor(sums: np.ndarray, valid: np.ndarray, says: str) -> None:
    one_line(lambda: Reconstructor(PHI, 16, 16).solve(sums, valid), says)


def test_sums_that_did_not_come_may_hold_anything() -> None:
    """Also what no float32 can hold, and without a warning."""
    valid = np.arange(64) % 2 > 0
    huge = np.where(valid, SUMS, 1e300)
    np.testing.assert_array_equal(
        Reconstructor(PHI, 16, 16).solve(huge, valid), Reconstructor(PHI, 16, 16).solve(SUMS, valid)
    )
