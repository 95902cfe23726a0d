"""``skin bench reconstruct``: our solvers against every other, on one problem, in one run, on one thread."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from evaluation.bench.peers import dense, peers
from evaluation.bench.problem import Method, Problem, compare, make_problem
from evaluation.bench.timing import race
from evaluation.result import Row
from reconstructor.bases import wavelet_basis
from reconstructor.checks import Values
from reconstructor.fista import largest_eigenvalue
from reconstructor.kernels.contourlet import CompiledContourlet, ContourletSolver
from reconstructor.kernels.haar import HaarSolver
from reconstructor.kernels.variation import VariationSolver
from reconstructor.settings import PAPER, PAPER_CONTOURLET, VARIATION, SolverSettings
from skin.layout import load_layout
from skin.surface import surface_of_positions
from touch.contact import Grid, Pose, press
from touch.objects import spheres_of

OURS: Final = "canskin"


def run(rounds: int) -> dict[str, Any]:
    """Return ``{"rows": […], "contourlet": […], "shapes": […]}``; rows as in the verb's docstring."""
    with threadpool_limits(1):
        haar = _rows(
            make_problem(wavelet_basis("haar-pyramid", 64, 64), PAPER.penalty_n, lipschitz=32.0), _haar, peers, rounds
        )
        psi = CompiledContourlet(64, 64)
        eigenvalue = largest_eigenvalue(load_layout().phi(), psi)
        contourlet = _rows(make_problem(psi, PAPER_CONTOURLET.penalty_n, eigenvalue), _contourlet, dense, rounds)
        shapes = _shapes(rounds)
    return {"rows": haar, "contourlet": contourlet, "shapes": shapes}


def _shapes(rounds: int) -> list[Row]:
    """Return the time of total variation on a grid, on the same skin as a graph, and on triangles in any order."""
    phi = load_layout().phi()
    row, column = np.divmod(np.random.default_rng(1).permutation(4096), 64)
    places = np.stack((column + 0.5 * (row % 2), row * 3**0.5 / 2, np.zeros(4096)), axis=1)
    solvers = {
        "64 x 64 taxels, grid": VariationSolver(phi, 64, 64, VARIATION),
        "64 x 64 taxels, graph": VariationSolver(phi, 64, 64, VARIATION, edges=load_layout().taxels.surface.edges),
        "4096 taxels in triangles, graph": VariationSolver(
            phi, 1, 4096, VARIATION, edges=surface_of_positions((0.004 * places).tolist()).edges
        ),
    }
    force_n = press(Grid(), [(spheres_of("golf-ball"), Pose(0.0, 0.0, 0.0, 0.01))]).ravel()
    sums_n, ones = np.asarray(phi.forward(force_n)), np.ones(phi.shape[0], np.float32)
    images = []
    for solver in solvers.values():
        estimate = solver.new_estimate()
        solver.solve(estimate, sums_n, ones)
        images.append(solver.deliver(estimate).ravel())
    calls = [partial(solver.solve, solver.new_estimate(), sums_n, ones) for solver in solvers.values()]
    times_s = [float(np.median(each)) for each in race(calls, rounds)]
    return [
        {
            "skin": name,
            "ms": 1e3 * own_s,
            "ratio_to_grid": own_s / times_s[0],
            "difference_un": 1e6 * float(np.abs(image - images[0]).max()) if image_is_grid else None,
        }
        for (name, own_s), image, image_is_grid in zip(
            zip(solvers, times_s, strict=True), images, (True, True, False), strict=True
        )
    ]


def _rows(problem: Problem, ours: Any, others: Any, rounds: int) -> list[Row]:
    methods: list[Method] = []
    for dtype in (np.float32, np.float64):
        methods += [ours(problem, dtype), *others(problem, dtype)]
    rows = compare(problem, methods, rounds)
    own_ms = {row["dtype"]: row["ms"] for row in rows if row["method"] == OURS}
    return [{**row, "ratio_to_ours": row["ms"] / own_ms[row["dtype"]]} for row in rows]


def _haar(problem: Problem, dtype: npt.DTypeLike) -> Method:
    settings = SolverSettings(prior="haar-pyramid", iterations=problem.iterations, penalty_n=problem.penalty_n)
    solver = HaarSolver(problem.phi, 64, 64, settings, dtype=dtype)
    start = solver.blocks_of(problem.psi.adjoint(problem.start.reshape(problem.psi.shape)))

    def coefficients(estimate: Values) -> Values:
        return problem.psi.forward(solver.image_of(estimate).astype(np.float64)).reshape(-1)

    return _ours(problem, solver, start, coefficients)


def _contourlet(problem: Problem, dtype: npt.DTypeLike) -> Method:
    settings = SolverSettings(prior="contourlet", iterations=problem.iterations, penalty_n=problem.penalty_n)
    solver = ContourletSolver(problem.phi, 64, 64, settings, dtype=dtype)
    return _ours(problem, solver, solver.estimate_of(problem.start), solver.coefficients_of)


def _ours(
    problem: Problem,
    solver: HaarSolver | ContourletSolver,
    start: Values,
    coefficients: Callable[[Values], Values],
) -> Method:
    sums, ones = problem.sums.astype(solver.dtype), np.ones(problem.sums.size, solver.dtype)
    estimate = solver.new_estimate()

    def solve() -> Values:
        estimate[:] = start
        solver.solve(estimate, sums, ones)
        return estimate

    return Method(OURS, solver.dtype.name, solve, coefficients)
