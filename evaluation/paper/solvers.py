"""ADMM and smoothed L0 against FISTA at equal time: why the paper chose FISTA (section V)."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Picture, Row, beside
from evaluation.paper.notes import objects_note
from evaluation.paper.pictures import draw_curves
from evaluation.paper.runs import OBJECTS, PENALTY_N, SIDE, felt_force, phi_seed, psnr_db, true_force
from reconstructor.bases import Basis, haar_tensor
from reconstructor.fista import fista, objective
from reconstructor.rivals import admm, smoothed_l0
from skin.measurement import sbhe
from skin.operator import Operator

SUMS: Final = 1024
PENALTY: Final = PENALTY_N["sbhe", "haar"]
#: Budgets: the time of so many iterations of FISTA.
BUDGETS: Final = (5, 10, 20, 50, 100)
#: Steps that are solved: in the press, and along the slide.
STEPS: Final = (800, 1500, 2500, 3900)
QUICK_STEPS: Final = (2500,)
#: What each rival may choose from; the best of each budget counts. ρ over the norm of Φ's rows, and last σ, newtons.
COUPLINGS: Final = (0.03, 0.1, 0.3, 1.0)
SMALLEST_N: Final = (0.0005, 0.001, 0.002)
#: Norm of the residual that smoothed L0 keeps, newtons: that of the noise, √m times 3.3 mN.
TOLERANCE_N: Final = 0.0033 * SUMS**0.5
#: Iterations behind the best objective, and repetitions of a timed run.
EXACT: Final = 3000
TIMED: Final = 5
Values = npt.NDArray[np.floating[Any]]
Run = Callable[..., Values]


def evaluate(options: Options) -> Findings:
    """Return PSNR and gap of the objective for each method, start and budget, means over frames."""
    meshes = str(options.meshes) if options.meshes else None
    steps = QUICK_STEPS if options.quick else STEPS
    cells = [{"name": name, "meshes": meshes, "step": step, "seed": options.seed} for name in OBJECTS for step in steps]
    found = measure_cells(measure, cells, options, "solvers", jobs=1)
    rows = []
    for key in found[0]:
        method, start, budget = key.split("|")
        group = [each[key] for each in found]
        row: Row = {"method": method, "start": start, "time_of_iterations": int(budget)}
        row["ms"] = round(float(np.mean([each["ms"] for each in group])), 2)
        row["iterations"] = int(np.median([each["iterations"] for each in group]))
        gaps = [each["gap"] for each in group]
        row["gap"] = float(f"{np.mean(gaps):.2g}") if None not in gaps else None
        rows.append(row | beside(float(np.mean([each["psnr_db"] for each in group])), None))
    notes = _notes(rows, len(cells), options)
    return Findings(
        "Solvers: ADMM and smoothed L0 against FISTA at equal time",
        rows,
        notes,
        [Picture("solvers", _CAPTION, lambda: _draw(rows))],
    )


_CAPTION: Final = (
    "Mean PSNR of single images against the time each method was given, from a cold start. Higher is better."
)


def measure(*, name: str, meshes: str | None, step: int, seed: int) -> Row:
    """Return time, iterations, PSNR and gap by ``method|start|budget`` of one frame.

    All are the plain NumPy forms with the same operators in float64, timed in turn in this process.
    """
    true = true_force(name, meshes, 1)[step - 1 : step + 1].astype(np.float64)
    felt = felt_force(true.astype(np.float32), seed, step).astype(np.float64)
    phi = sbhe(SIDE * SIDE, SUMS, selection="uniform", seed=phi_seed(seed, 0))
    psi = haar_tensor(SIDE, SIDE)
    before, sums_n = (phi.forward(each.reshape(-1)).astype(np.float64) for each in felt)
    solve = partial(fista, phi, psi, penalty_n=PENALTY, lipschitz=phi.norm_squared)
    warm = solve(before, iterations=100)
    best = objective(phi, psi, sums_n, solve(sums_n, iterations=EXACT, start=warm), PENALTY)
    runs = _runs(phi, psi, sums_n)
    costs_s = {method: min(_cost_s(run) for run in choices) for method, choices in runs.items()}
    told: Row = {}
    for budget in BUDGETS:
        allowed_s = budget * costs_s["FISTA"]
        for method, choices in runs.items():
            count = max(1, int(allowed_s / costs_s[method] + 0.5))
            for start, given in (("cold", None), ("warm", warm)):
                if given is not None and method == "smoothed L0":
                    continue  # it begins from the least-squares solution
                results = [run(count, given) for run in choices]
                levels = [psnr_db(np.maximum(psi.adjoint(s), 0), true[1]) for s in results]
                gaps = [objective(phi, psi, sums_n, s, PENALTY) / best - 1 for s in results]
                told[f"{method}|{start}|{budget}"] = {
                    "ms": 1e3 * count * costs_s[method],
                    "iterations": count,
                    "psnr_db": max(levels),
                    "gap": None if method == "smoothed L0" else min(gaps),
                }
    return told


def _runs(phi: Operator, psi: Basis, sums_n: Values) -> dict[str, Sequence[Run]]:
    """Return what runs each method for (iterations, start), one for each setting it may choose."""
    norm = phi.norm_squared

    def step_of(ratio: float) -> Run:
        return lambda count, start=None: fista(
            phi, psi, sums_n, penalty_n=PENALTY, lipschitz=ratio * norm, iterations=count, start=start
        )

    def coupled(ratio: float) -> Run:
        return lambda count, start=None: admm(
            phi, psi, sums_n, penalty_n=PENALTY, iterations=count, coupling=ratio * norm, start=start
        )

    return {
        "FISTA": [step_of(2.0)],
        "FISTA, exact step": [step_of(1.0)],
        "ADMM": [coupled(ratio) for ratio in COUPLINGS],
        "smoothed L0": [partial(_smoothed, phi, psi, sums_n, smallest_n) for smallest_n in SMALLEST_N],
    }


def _smoothed(
    phi: Operator, psi: Basis, sums_n: Values, smallest_n: float, count: int, _start: Values | None = None
) -> Values:
    """Return smoothed L0's result with σ falling so fast that `count` steps bring it to its last."""
    inner = 3 if count >= 9 else 1
    turns = max(1, round(count / inner))
    widest = 2 * float(np.abs(psi.forward(phi.adjoint(sums_n).reshape(SIDE, SIDE))).max()) / phi.norm_squared
    # The loop runs while σ is above its last value: a hair more than `turns` shrinkages reach it.
    shrink = min(0.99, (smallest_n / widest) ** (1 / turns) * (1 - 1e-9))
    return smoothed_l0(phi, psi, sums_n, tolerance_n=TOLERANCE_N, smallest_n=smallest_n, shrink=shrink, inner=inner)


def _cost_s(run: Run, count: int = 30) -> float:
    """Return the least time of one iteration."""
    least = float("inf")
    for _ in range(TIMED):
        started_s = time.perf_counter()
        run(count)
        least = min(least, time.perf_counter() - started_s)
    return least / count


def _notes(rows: list[Row], frames: int, options: Options) -> list[str]:
    cold = {(row["method"], row["time_of_iterations"]): row["ours"] for row in rows if row["start"] == "cold"}
    at = 20
    order = sorted((method for method, budget in cold if budget == at), key=lambda each: -cold[each, at])
    told = ", ".join(f"{method} {cold[method, at]:.2f} dB" for method in order)
    return [
        objects_note(options),
        (
            f"Means over {frames} frames, {SUMS} sums, tensor Haar, λ = {PENALTY:g} N for FISTA and ADMM. Plain NumPy "
            "forms with the same operators, times from the same process; each runs as many iterations as fit the time "
            "of so many of FISTA's."
        ),
        (
            "ADMM may choose its coupling and smoothed L0 its last σ for every frame and budget by the result; FISTA "
            "chooses nothing. A gap is (F - F*) / F* of the objective; smoothed L0 has another one."
        ),
        (
            f"From a cold start, in the time of {at} iterations: {told}. The paper reports that it found FISTA the "
            "fastest, without numbers."
        ),
    ]


def _draw(rows: list[Row]) -> Any:
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for row in rows:
        if row["start"] == "cold":
            across, up = curves.setdefault(row["method"], ([], []))
            across.append(row["ms"])
            up.append(row["ours"])
    return draw_curves(curves, "time, ms", "PSNR, dB")
