"""The solvers of the service against the plain one."""

import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstructor.bases import wavelet_basis
from reconstructor.engine import make_solver
from reconstructor.kernels import variation
from reconstructor.kernels.addresses import spin_shifts
from reconstructor.kernels.haar import HaarSolver
from reconstructor.kernels.variation import VariationSolver
from reconstructor.settings import SPUN, SolverSettings
from reconstructor.wavelet_solver import WaveletSolver
from skin.phi import Sbhe, sbhe
from skin.surface import grid_surface
from tests.reconstructor.helpers import graphs
from tests.reconstructor.reference import Proximal, Shrinkage, Variation, fista_image


class Rows:
    """Φ with rows deleted."""

    def __init__(self, phi: Sbhe, kept: np.ndarray) -> None:
        self._phi, self._kept = phi, kept
        self.shape = (int(kept.sum()), phi.shape[1])

    def forward(self, x: np.ndarray) -> Any:
        return self._phi.forward(x)[self._kept]

    def adjoint(self, y: np.ndarray) -> Any:
        full = np.zeros(self._kept.size, y.dtype)
        full[self._kept] = y
        return self._phi.adjoint(full)


@st.composite
def problems(draw: st.DrawFn) -> dict[str, Any]:
    wavelets = ["sym4-pyramid", "coif1-tensor", "d4-pyramid"]
    prior = draw(st.sampled_from([*HaarSolver.priors, *VariationSolver.priors, *wavelets]))
    grids = [(8, 8), (16, 16), (32, 32), (64, 64), (8, 32), (64, 16), (256, 8)]
    if prior == "variation":
        grids += [(10, 10), (17, 23), (24, 32), (1, 8), (9, 1), (255, 3)]
    rows, columns = draw(st.sampled_from(grids))
    edges = draw(st.none() | graphs(rows * columns)) if prior == "variation" else None
    block_size = 2 ** draw(st.integers(1, min(8, (rows * columns).bit_length() - 1)))
    selection = draw(st.sampled_from(["balanced", "uniform"]))
    blocks = -(-rows * columns // block_size)
    sums = blocks * draw(st.integers(1, block_size))
    seed = draw(st.integers(0, 2**31))
    return {
        "phi": sbhe(rows * columns, sums, block_size=block_size, selection=selection, seed=seed),
        "grid": (rows, columns),
        "edges": edges,
        "prior": prior,
        "spins": draw(st.sampled_from([1, 3, 64])) if prior != "variation" else 1,
        "nonnegative": draw(st.booleans()),
        "lipschitz_ratio": draw(st.sampled_from([1.0, 2.0])),
        "iterations": draw(st.integers(1, 12)),
        "missing_ratio": draw(st.sampled_from([0.0, 0.1, 0.9])),
        "seed": seed,
    }


def proximal_of(problem: dict[str, Any]) -> Proximal:
    if problem["prior"] == "variation":
        nonnegative, edges = problem["nonnegative"], problem["edges"]
        return Variation(problem["grid"], variation.INNER, nonnegative=nonnegative, edges=edges)
    shifts = spin_shifts(problem["spins"], *problem["grid"])
    return Shrinkage(wavelet_basis(problem["prior"], *problem["grid"]), shifts, problem["nonnegative"])


def both(problem: dict[str, Any], dtype: type) -> tuple[np.ndarray, np.ndarray]:
    """Solve with the kernel, and with the reference after deleting the invalid rows."""
    phi, (rows, columns), rng = problem["phi"], problem["grid"], np.random.default_rng(problem["seed"])
    start = np.abs(rng.normal(0, 0.005, (rows, columns)))
    sums = rng.normal(0, 0.03, phi.shape[0])
    valid = rng.random(phi.shape[0]) >= problem["missing_ratio"]
    options = {name: problem[name] for name in ("prior", "spins", "nonnegative", "lipschitz_ratio", "iterations")}
    settings = SolverSettings(penalty_n=0.01, **options)
    kernel: Any = make_solver(phi, rows, columns, settings, edges=problem["edges"], dtype=dtype)
    is_image = isinstance(kernel, WaveletSolver)
    estimate = start.astype(dtype) if is_image else kernel.blocks_of(start)
    assert kernel.solve(estimate, np.where(valid, sums, 1e6).astype(dtype), valid.astype(dtype)) == valid.sum()
    reference = fista_image(
        Rows(phi, valid),
        proximal_of(problem),
        sums[valid],
        penalty_n=0.01,
        lipschitz=problem["lipschitz_ratio"] * phi.block_size,
        iterations=problem["iterations"],
        start=start,
    )
    np.testing.assert_allclose(kernel.deliver(estimate), np.maximum(reference, 0), atol=1e-6)
    return estimate if is_image else kernel.image_of(estimate), reference


@pytest.mark.heavy
@given(problems())
@settings(max_examples=60, deadline=None)
def test_equals_the_reference_with_rows_deleted(problem: dict[str, Any]) -> None:
    image, reference = both(problem, np.float64)
    np.testing.assert_allclose(image, reference, atol=1e-13)


@pytest.mark.heavy
@given(problems())
@settings(max_examples=25, deadline=None)
def test_equals_the_reference_in_single_precision(problem: dict[str, Any]) -> None:
    image, reference = both(problem, np.float32)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, reference, atol=1e-6)


@pytest.mark.heavy
def test_largest_grid() -> None:
    problem = {
        "phi": sbhe(65536, 8192, block_size=256),
        "grid": (256, 256),
        "edges": None,
        "prior": "haar-pyramid",
        "spins": 2,
        "nonnegative": True,
        "lipschitz_ratio": 1.0,
        "iterations": 3,
        "missing_ratio": 0.1,
        "seed": 1,
    }
    image, reference = both(problem, np.float64)
    np.testing.assert_allclose(image, reference, atol=1e-13)


def test_any_wavelet_scales_its_start_as_the_compiled_haar_does() -> None:
    phi, rng = sbhe(512, 128, block_size=16, selection="uniform", seed=3), np.random.default_rng(1)
    solvers = [solver(phi, 16, 32, SPUN, dtype=np.float64) for solver in (WaveletSolver, HaarSolver)]
    estimates = [solver.new_estimate() for solver in solvers]
    for sign in (1, 1, -1):
        sums_n, weights = sign * rng.normal(0.03, 0.03, 128), rng.uniform(0, 1, 128)
        for solver, estimate in zip(solvers, estimates, strict=True):
            solver.solve(estimate, sums_n, weights, relative_penalty=0.5)
        np.testing.assert_allclose(estimates[0], solvers[1].image_of(estimates[1]), atol=1e-14)
    assert estimates[0].any()


@given(st.integers(0, 2**31))
@settings(max_examples=10, deadline=None)
@pytest.mark.heavy
def test_a_grid_as_a_graph_has_the_images_of_the_grid(seed: int) -> None:
    phi, rng = sbhe(768, 192, seed=seed), np.random.default_rng(seed)
    options = SolverSettings(prior="variation", iterations=10, penalty_n=0.01, nonnegative=True, scaled_start=True)
    edges = grid_surface(24, 32, 1.0, np.zeros(0, np.intp)).edges
    solvers = VariationSolver(phi, 24, 32, options), VariationSolver(phi, 24, 32, options, edges=edges)
    estimates = [solver.new_estimate() for solver in solvers]
    for _ in range(3):
        sums_n = rng.normal(0, 0.03, 192).astype(np.float32)
        for solver, estimate in zip(solvers, estimates, strict=True):
            solver.solve(estimate, sums_n, np.ones(192, np.float32))
    grid, graph = (solver.deliver(estimate) for solver, estimate in zip(solvers, estimates, strict=True))
    np.testing.assert_allclose(graph, grid, atol=1e-7)


def test_shifts_differ_and_begin_with_none() -> None:
    assert len(set(spin_shifts(64, 64, 64))) == 64
    assert spin_shifts(1, 64, 64) == [(0, 0)]
    assert (
        {down for down, _ in spin_shifts(8, 64, 64)} == {right for _, right in spin_shifts(8, 64, 64)} == set(range(8))
    )


def test_weights_are_those_of_a_weighted_problem() -> None:
    """ΦᵀWΦ and ΦᵀW y: the same as the problem of rows √w Φ and sums √w y."""
    phi, rng = sbhe(256, 64, block_size=16, seed=3), np.random.default_rng(0)
    sums, weights = rng.normal(0, 0.03, 64), rng.uniform(0, 1, 64)
    kernel = HaarSolver(
        phi, 16, 16, SolverSettings(prior="haar-pyramid", iterations=9, penalty_n=0.01), dtype=np.float64
    )
    estimate = kernel.new_estimate()
    assert kernel.solve(estimate, sums, weights) == 64
    roots = np.sqrt(weights)

    class Weighted(Rows):
        def forward(self, x: np.ndarray) -> Any:
            return roots * super().forward(x)

        def adjoint(self, y: np.ndarray) -> Any:
            return super().adjoint(roots * y)

    reference = fista_image(
        Weighted(phi, np.ones(64, np.bool_)),
        Shrinkage(wavelet_basis("haar-pyramid", 16, 16)),
        roots * sums,
        penalty_n=0.01,
        lipschitz=16,
        iterations=9,
        start=np.zeros((16, 16)),
    )
    np.testing.assert_allclose(kernel.image_of(estimate), reference, atol=1e-13)


def test_relative_penalty_and_reset() -> None:
    phi = sbhe(256, 64, block_size=16, seed=3)
    sums, ones = np.random.default_rng(0).normal(0, 0.03, 64), np.ones(64)
    results = []
    for penalty_n, relative in ((0.02, 0.5), (0.01, 1.0)):
        settings = SolverSettings(prior="variation", iterations=9, penalty_n=penalty_n)
        kernel = VariationSolver(phi, 16, 16, settings, dtype=np.float64)
        for _ in range(2):  # after a reset it is as new
            kernel.reset()
            estimate = kernel.new_estimate()
            kernel.solve(estimate, sums, ones, relative_penalty=relative)
            results.append(kernel.deliver(estimate))
    for each in results[1:]:
        np.testing.assert_array_equal(each, results[0])
    assert results[0].min() == 0
    assert results[0].any()


@pytest.mark.heavy
def test_the_interpreter_is_free_while_a_kernel_runs(phi: Sbhe) -> None:
    """Another thread gets to run between begin and end of one call, many times over."""
    many, one = (SolverSettings(prior="variation", iterations=count, penalty_n=0.01) for count in (100_000, 1))
    solver = VariationSolver(phi, 64, 64, many)
    estimate, sums, weights = solver.new_estimate(), np.full(1024, 0.01, np.float32), np.ones(1024, np.float32)
    VariationSolver(phi, 64, 64, one).solve(estimate, sums, weights)  # compiles
    inside = threading.Event()
    turns = 0

    def solve() -> None:
        inside.set()
        solver.solve(estimate, sums, weights)

    thread = threading.Thread(target=solve)
    thread.start()
    inside.wait()
    while thread.is_alive():
        turns += 1
        thread.join(0.001)
    assert turns > 10


@pytest.mark.heavy
@given(st.integers(0, 2**31), st.integers(1, 12), st.booleans())
@settings(max_examples=20, deadline=None)
def test_patches_with_a_gap_between_them_are_as_if_alone(seed: int, iterations: int, stands: bool) -> None:
    """Two patches of 7 x 6 on a grid with a gap, side by side or one above the other."""
    rng = np.random.default_rng(seed)
    shape = (15, 6) if stands else (7, 13)
    grid = np.arange(shape[0] * shape[1]).reshape(shape)
    parts = (grid[:7], grid[8:]) if stands else (grid[:, :6], grid[:, 7:])
    alone = [sbhe(42, 24, block_size=16, seed=seed + number) for number in range(2)]
    held = [np.where(phi.order < 42, part.ravel()[phi.order % 42], -1) for phi, part in zip(alone, parts, strict=True)]
    order = np.concatenate(held)
    order[order < 0] = grid.size + np.arange((order < 0).sum())
    whole = Sbhe(order, np.concatenate([phi.kept for phi in alone]), grid.size)
    options = SolverSettings(prior="variation", iterations=iterations, penalty_n=0.01, scaled_start=False)
    sums = [rng.normal(0, 0.03, phi.shape[0]) for phi in alone]

    def solved(phi: Sbhe, rows: int, columns: int, sums_n: np.ndarray) -> np.ndarray:
        kernel = VariationSolver(phi, rows, columns, options, dtype=np.float64)
        estimate = kernel.new_estimate()
        kernel.solve(estimate, sums_n, np.ones_like(sums_n))
        np.testing.assert_array_equal(kernel.deliver(estimate), kernel.image_of(estimate).clip(0).astype(np.float32))
        return kernel.image_of(estimate).ravel()

    image = solved(whole, *shape, np.concatenate(sums))
    for phi, part, sums_n in zip(alone, parts, sums, strict=True):
        np.testing.assert_allclose(image[part.ravel()], solved(phi, 7, 6, sums_n), atol=1e-13)
    assert not image[~whole.is_wired].any()
