"""Everything that cannot be computed is refused: one line that says what was expected and what came."""

from collections.abc import Callable, Iterator
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
#: A measurement operator of another kind.
OTHER: Any = SimpleNamespace(shape=(64, 256), dtype=np.dtype(np.int8))
PSI, WIDE = wavelet_basis("haar-tensor", 16, 16), wavelet_basis("haar-tensor", 16, 32)
SUMS, ONES = np.random.default_rng(0).normal(0, 0.02, 64), np.ones(64)
FISTA: dict[str, Any] = {"sums_n": SUMS, "penalty_n": 0.01, "lipschitz": 16.0, "iterations": 3}
Case = tuple[Callable[[], Any], str]


def settings(prior: str = "haar-tensor", **changed: Any) -> SolverSettings:
    return SolverSettings(**{"prior": prior, "iterations": 3, "penalty_n": 0.01, **changed})


SOLVERS: dict[str, Callable[..., Any]] = {
    "haar": lambda **o: HaarSolver(PHI, 16, 16, settings("haar-pyramid"), **o),
    "variation": lambda **o: VariationSolver(PHI, 16, 16, settings("variation"), **o),
    "contourlet": lambda **o: ContourletSolver(PHI, 16, 16, settings("contourlet"), **o),
    "wavelets": lambda **o: WaveletSolver(PHI, 16, 16, settings(), **o),
}


def operators() -> Iterator[Case]:
    for spoil, says in (
        (lambda x: x[:-1], "shape"),
        (lambda x: x.reshape(-1, 1), "shape"),
        (list, "array"),
        (lambda x: x.astype(object), "object"),
        (lambda x: spoilt(x, NAN), "finite"),
        (lambda x: spoilt(x, -INF), "finite"),
    ):
        yield partial(PHI.forward, spoil(np.ones(256))), says
        yield partial(PHI.adjoint, spoil(ONES)), says
    for valid in (np.ones(15, np.bool_), np.ones(17, np.bool_), np.ones(16), np.ones((16, 1), np.bool_)):
        yield partial(PHI.sums_of_blocks, valid), "expected 16 booleans, one a block"
    for sizes, options, says in (
        ((256, 0), {}, "1 to 256 sums"),
        ((256, 257), {}, "1 to 256 sums"),
        ((0, 0), {}, "one taxel or more"),
        ((256, 64), {"block_size": -32}, "power of two"),
        ((256, 64), {"block_size": 24}, "power of two"),
        ((256, 65), {}, "multiple of 8 blocks"),
        ((256, 64), {"selection": "every"}, "balanced or uniform"),
        ((256, 64), {"seed": -1}, "seed"),
        ((256.0, 64), {}, "whole numbers"),
    ):
        yield partial(sbhe, *sizes, **options), says  # type: ignore[arg-type]  # wrong on purpose


def bases() -> Iterator[Case]:
    names = ("haar-tensor", "haar-pyramid", "d4-tensor", "d4-pyramid")
    for psi in (*(wavelet_basis(name, 16, 16) for name in names), CompiledContourlet(16, 16)):
        for spoil, says in (
            (lambda x: x[:-1], "expected an array of float32 or float64 of shape"),
            (list, "got list"),
            (lambda x: x.astype(np.float16), "got float16"),
            (lambda x: spoilt(x, NAN), "finite numbers"),
        ):
            yield partial(psi.forward, spoil(np.ones((16, 16)))), says
            yield partial(psi.adjoint, spoil(np.ones(psi.shape))), says
    for make in (*(partial(wavelet_basis, name) for name in names), CompiledContourlet):
        for grid in ((-16, -16), (12, 12), (4, 4), (512, 512), (16.0, 16.0)):
            yield partial(make, *grid), "power(s)? of two, (8|16) to 256"  # type: ignore[arg-type]  # wrong on purpose
    for grid in ((16, 32), (8, 8)):
        yield partial(CompiledContourlet, *grid), "square"


def plain_solver() -> Iterator[Case]:
    for changed, says in (
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
        *(({"lipschitz": value}, "L needs a number above 0") for value in (0.0, -16.0, NAN, INF)),
    ):
        yield partial(fista, PHI, PSI, **{**FISTA, **changed}), says
    for call in (
        partial(fista, PHI, WIDE, **FISTA),
        partial(largest_eigenvalue, PHI, WIDE),
        partial(objective, PHI, WIDE, SUMS, np.zeros((16, 32)), 0.01),
    ):
        yield call, "256 taxels but the image of Ψ has 512"
    yield partial(objective, PHI, PSI, SUMS, np.zeros(256), 0.01), "start: .*shape"


def of_settings() -> Iterator[Case]:
    for changed, says in (
        ({"iterations": 0}, "at least 1 iteration"),
        ({"iterations": 1.5}, "at least 1 iteration"),
        ({"iterations": 10**9}, "at most 100000 iterations"),
        *(({"penalty_n": value}, "penalty") for value in (-1e-9, NAN, INF)),
        ({"lipschitz_ratio": 0.99}, "diverges"),
        ({"lipschitz_ratio": NAN}, "diverges"),
        ({"prior": "fourier"}, "unknown basis 'fourier': expected an orthogonal wavelet"),
        ({"prior": "sym4"}, "expected the full name 'sym4-pyramid'"),
        *(({"spins": value}, "1 to 64 spins") for value in (0, 65, 2.0)),
        ({"prior": "variation", "spins": 2}, "no wavelet basis to shift"),
        ({"prior": "contourlet", "spins": 2}, "no wavelet basis to shift"),
        ({"prior": "contourlet", "nonnegative": True}, "neither nonnegative nor scaled_start"),
        ({"prior": "contourlet", "scaled_start": True}, "neither nonnegative nor scaled_start"),
    ):
        yield partial(settings, **changed), says
    for make in SOLVERS.values():
        for dtype, name in ((np.int32, "int32"), (np.float16, "float16"), ("single precision", "single precision")):
            yield partial(make, dtype=dtype), f"float32 or float64, got {name}"
    yield lambda: HaarSolver(PHI, 16, 16, settings("contourlet")), "expected one of haar-pyramid, haar-tensor, got 'con"
    yield lambda: ContourletSolver(PHI, 16, 16, settings("variation")), "the prior 'contourlet', got 'variation'"
    for call in (
        lambda: HaarSolver(OTHER, 16, 16, settings()),
        lambda: ContourletSolver(OTHER, 16, 16, settings("contourlet")),
        lambda: WaveletSolver(OTHER, 16, 16, settings()),
        lambda: Reconstructor(OTHER, 16, 16),
    ):
        yield call, "needs an SBHE, got SimpleNamespace"


def images() -> Iterator[Case]:
    haar, contourlet = HaarSolver(PHI, 16, 16, settings()), ContourletSolver(PHI, 16, 16, settings("contourlet"))
    yield partial(haar.blocks_of, np.zeros(256)), "image: .*shape"
    yield partial(haar.image_of, np.zeros(255)), "estimate: .*shape"
    yield partial(contourlet.estimate_of, np.zeros(256)), "coefficients: .*shape"
    yield partial(contourlet.coefficients_of, np.zeros(256)), "estimate: .*shape"
    for sums, valid, says in (
        (SUMS[:-1], ONES > 0, "64 sums"),
        (SUMS, ONES[:-1] > 0, "64 sums"),
        (SUMS[None], ONES > 0, "64 sums"),
        (list(SUMS), ONES > 0, "expected arrays, got list"),
        (SUMS, ONES, "floats and bools, got float64 and float64"),
        (SUMS.astype(np.complex64), ONES > 0, "got complex64"),
        (spoilt(SUMS, NAN), ONES > 0, "not finite"),
        (spoilt(SUMS, -1e300), ONES > 0, "above 1e6"),
    ):
        yield partial(Reconstructor(PHI, 16, 16).solve, sums, valid), says  # type: ignore[arg-type]  # wrong on purpose


@pytest.mark.parametrize("cases", [operators, bases, plain_solver, of_settings, images])
def test_what_cannot_be_computed_is_refused_in_one_line(cases: Callable[[], Iterator[Case]]) -> None:
    for call, says in cases():
        one_line(call, says)


@pytest.mark.parametrize("kind", SOLVERS)
def test_a_solver_that_refuses_arrays_leaves_the_estimate(kind: str) -> None:
    solver = SOLVERS[kind](dtype=np.float64)
    given = [solver.new_estimate(), SUMS, ONES]
    solver.solve(*given)
    before = given[0].copy()
    for place, spoil, says in (
        (0, lambda x: x[:-1], "estimate: .*shape"),
        (0, lambda x: x.astype(np.float32), "estimate: .*float32"),
        (0, lambda x: np.repeat(x, 2, axis=-1)[..., ::2], "estimate: expected contiguous, writeable"),
        (0, lambda x: np.broadcast_to(x, x.shape), "estimate: expected contiguous, writeable"),
        (1, lambda x: x[:-1], "sums: .*shape"),
        (1, lambda x: x.astype(np.float32), "sums: .*float32"),
        (1, lambda x: spoilt(x, NAN), "sums of at most 1e6 N"),
        (1, lambda x: spoilt(x, 1e30), "sums of at most 1e6 N"),
        (2, lambda x: x[:-1], "weights: .*shape"),
        (2, lambda x: x > 0, "weights: .*bool"),
        (2, lambda x: spoilt(x, 1.5), "weights of 0 to 1"),
        (2, lambda x: spoilt(x, -0.1), "weights of 0 to 1"),
    ):
        wrong = [*given]
        wrong[place] = spoil(given[place])
        one_line(partial(solver.solve, *wrong), says)
    for value in (-1, NAN):
        one_line(partial(solver.solve, *given, relative_penalty=value), "relative penalty")
    np.testing.assert_array_equal(given[0], before)
    one_line(partial(solver.deliver, before[:-1]), "estimate: .*shape")


def test_sums_that_did_not_come_may_hold_anything() -> None:
    """Also what no float32 can hold, and without a warning."""
    valid = np.arange(64) % 2 > 0
    huge = np.where(valid, SUMS, 1e300)
    np.testing.assert_array_equal(
        Reconstructor(PHI, 16, 16).solve(huge, valid), Reconstructor(PHI, 16, 16).solve(SUMS, valid)
    )
