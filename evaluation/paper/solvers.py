"""ADMM and smoothed L0 against FISTA at equal time: why the paper chose FISTA (section V)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.paper.pictures import draw_curves
from evaluation.paper.runs import OBJECTS, SIDE, felt_force, phi_seed, true_force
from evaluation.result import Options, Picture, Result, Row, beside
from evaluation.result_cache import measure_cells
from evaluation.solvers.baselines import admm, smoothed_l0
from reconstructor.bases import Basis, wavelet_basis
from reconstructor.checks import Values
from reconstructor.fista import fista, objective
from reconstructor.settings import PAPER
from skin.measurement import sbhe
from skin.operator import Operator
from skin.psnr import psnr_db

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUMS: Final = 1024
PENALTY: Final = PAPER.penalty_n
#: Budgets of time, in iterations of the paper's FISTA.
BUDGETS: Final = (5, 10, 20, 50, 100)
#: Steps that are solved: at the end of the press, and on the slide.
STEPS: Final = (800, 2500)
QUICK_STEPS: Final = (2500,)
#: Iterations behind the best objective and behind a warm start; those of a timed run, and how often it is repeated.
EXACT, WARM, TIMED, REPEATS = 500, 100, 20, 3
#: Settings of the baselines; the best is chosen for each budget: ρ over the norm of Φ's rows, and the last σ, newtons.
COUPLINGS: Final = (0.03, 0.1, 0.3, 1.0)
SMALLEST_N: Final = (0.0001, 0.0002, 0.0005, 0.001)
#: Norm of the residual that smoothed L0 keeps, newtons: that of the noise, √m times 3.3 mN.
TOLERANCE_N: Final = 0.0033 * SUMS**0.5
STARTS: Final = ("cold", "warm")
#: The method whose iterations set the budgets.
PAPERS: Final = "FISTA"
CAPTION: Final = (
    "Mean PSNR of single images from a cold start against the time each method was given. Higher and further left is "
    "better; FISTA and ADMM have the same minimum."
)
#: Takes numbers of iterations and the start, and returns the coefficients after each of these numbers.
Run = Callable[[set[int], Values | None], dict[int, Values]]


@dataclass(frozen=True)
class Solver:
    """A method with one of its settings, both as shown.

    Attributes
    ----------
    run : callable
        Makes the coefficients.
    starts : tuple of str
        Those of `STARTS` that the method can begin from.
    same_objective : bool
        True where the method minimises FISTA's objective, so that its gap says something.
    """

    method: str
    setting: str
    run: Run
    starts: tuple[str, ...] = STARTS
    same_objective: bool = True


def evaluate(options: Options) -> Result:
    """Return PSNR and gap of the objective for each method, start and budget, means over frames."""
    steps = QUICK_STEPS if options.quick else STEPS
    cells = [{"name": name, "step": step, **options.shared} for name in OBJECTS for step in steps]
    rows = _best(measure_cells(measure, cells, options, "solvers", jobs=1))
    title = "Solvers: ADMM and smoothed L0 against FISTA at equal time"
    return Result(title, rows, [Picture(CAPTION, lambda: _draw(rows))])


def _best(found: list[Row]) -> list[Row]:
    """Return the rows: of each method, start and budget, the setting of the best mean PSNR over frames."""
    rows: dict[tuple[str, str, int], Row] = {}
    for group in zip(*(each["runs"] for each in found), strict=True):
        first = group[0]
        gaps = [each["gap"] for each in group if each["gap"] is not None]
        place = {key: first[key] for key in ("method", "start", "in_time_of")}
        row = {
            **place,
            "ms": round(float(np.mean([each["ms"] for each in group])), 2),
            "iterations": int(np.median([each["iterations"] for each in group])),
            "setting": first["setting"],
            "gap": float(f"{np.mean(gaps):.2g}") if gaps else None,
            **beside(float(np.mean([each["psnr_db"] for each in group])), None),
        }
        best = rows.setdefault(tuple(place.values()), row)
        if row["ours"] > best["ours"]:
            rows[tuple(place.values())] = row
    return sorted(rows.values(), key=lambda row: (row["start"], row["in_time_of"]))


def measure(*, name: str, meshes: str | None, step: int, seed: int) -> Row:
    """Return ``runs`` of one frame: a row with time, iterations, PSNR and gap for each solver, start and budget.

    All are the plain NumPy forms with the same operators in float64, timed in turn in this process.
    """
    true = true_force(name, meshes, 1)[step - 1 : step + 1]
    felt = felt_force(true, seed, step).astype(np.float64)
    phi = sbhe(SIDE * SIDE, SUMS, selection="uniform", seed=phi_seed(seed, 0))
    psi = wavelet_basis("haar-tensor", SIDE, SIDE)
    before, sums_n = (phi.forward(each.reshape(-1)).astype(np.float64) for each in felt)
    solve = partial(fista, phi, psi, penalty_n=PENALTY, lipschitz=phi.norm_squared)
    warm = solve(before, iterations=WARM)
    best = objective(phi, psi, sums_n, solve(sums_n, iterations=EXACT, start=warm), PENALTY)
    solvers = make_solvers(phi, psi, sums_n)
    cost_s = costs_s(solvers)
    runs: list[Row] = []
    for each in solvers:
        counts = {budget: max(1, round(budget * cost_s[PAPERS] / cost_s[each.method])) for budget in BUDGETS}
        for start in each.starts:
            estimates = each.run(set(counts.values()), warm if start == "warm" else None)
            for budget, count in counts.items():
                s = estimates[count]
                gap = objective(phi, psi, sums_n, s, PENALTY) / best - 1 if each.same_objective else None
                runs.append(
                    {
                        "method": each.method,
                        "setting": each.setting,
                        "start": start,
                        "in_time_of": budget,
                        "ms": 1e3 * count * cost_s[each.method],
                        "iterations": count,
                        "psnr_db": psnr_db(true[1], np.maximum(psi.adjoint(s), 0).astype(np.float32)),
                        "gap": gap,
                    }
                )
    return {"runs": runs}


def make_solvers(phi: Operator, psi: Basis, sums_n: Values) -> list[Solver]:
    """Return each method with each of its settings."""
    norm = phi.norm_squared

    def stepped(ratio: float) -> Run:
        return _observed(partial(fista, phi, psi, sums_n, penalty_n=PENALTY, lipschitz=ratio * norm))

    def coupled(ratio: float) -> Run:
        return _observed(partial(admm, phi, psi, sums_n, penalty_n=PENALTY, coupling=ratio * norm))

    def smoothed(smallest_n: float) -> Run:
        # How fast σ falls depends on how many steps there are: each number of iterations is a run of its own.
        return lambda counts, _start: {count: _smoothed(phi, psi, sums_n, smallest_n, count) for count in counts}

    return [
        Solver(PAPERS, "L = 2B (paper)", stepped(2.0)),
        Solver("FISTA, exact step", "L = B", stepped(1.0)),
        *(Solver("ADMM", f"ρ = {ratio:g} B", coupled(ratio)) for ratio in COUPLINGS),
        *(
            # It begins from the least-squares solution, whatever the frame before.
            Solver("smoothed L0", f"σ to {1e3 * smallest:g} mN", smoothed(smallest), ("cold",), same_objective=False)
            for smallest in SMALLEST_N
        ),
    ]


def _observed(solve: Callable[..., Values]) -> Run:
    """Return a run of `solve` that lasts as long as the largest number asks and keeps the estimates on its way."""

    def run(counts: set[int], start: Values | None) -> dict[int, Values]:
        kept: dict[int, Values] = {}

        def observe(iteration: int, estimate: Values) -> None:
            if iteration in counts:
                kept[iteration] = estimate.copy()

        solve(iterations=max(counts), start=start, observe=observe)
        return kept

    return run


def _smoothed(phi: Operator, psi: Basis, sums_n: Values, smallest_n: float, count: int) -> Values:
    """Return smoothed L0's result with σ falling so fast that some `count` steps bring it to its last."""
    inner = 3 if count >= 9 else 1
    turns = max(1, round(count / inner))
    widest = 2 * float(np.abs(psi.forward(phi.adjoint(sums_n).reshape(SIDE, SIDE))).max()) / phi.norm_squared
    # The loop runs while σ is above its last: a hair less than `turns` shrinkages would leave one more.
    shrink = min(0.99, (smallest_n / widest) ** (1 / turns) * (1 - 1e-9))
    return smoothed_l0(phi, psi, sums_n, tolerance_n=TOLERANCE_N, smallest_n=smallest_n, shrink=shrink, inner=inner)


def costs_s(solvers: Sequence[Solver]) -> dict[str, float]:
    """Return the least time of one iteration of each method, all taking turns."""
    least: dict[str, float] = {}
    for _ in range(REPEATS):
        for each in solvers:
            started_s = time.perf_counter()
            each.run({TIMED}, None)
            spent_s = (time.perf_counter() - started_s) / TIMED
            least[each.method] = min(spent_s, least.get(each.method, spent_s))
    return least


def _draw(rows: list[Row]) -> "Figure":
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for row in rows:
        if row["start"] == "cold":
            across, up = curves.setdefault(row["method"], ([], []))
            across.append(row["ms"])
            up.append(row["ours"])
    return draw_curves(curves, "time, ms")
