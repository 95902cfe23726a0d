"""ADMM and smoothed L0 against FISTA at equal time: why the paper chose FISTA (section V)."""

import time
from collections.abc import Callable
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
#: Budgets: the time of so many iterations of the paper's FISTA.
BUDGETS: Final = (5, 10, 20, 50, 100)
#: Steps that are solved: at the end of the press, and on the slide.
STEPS: Final = (800, 2500)
QUICK_STEPS: Final = (2500,)
#: What each rival may choose from, once for each budget: ρ over the norm of Φ's rows, and the last σ, newtons.
COUPLINGS: Final = (0.03, 0.1, 0.3, 1.0)
SMALLEST_N: Final = (0.0001, 0.0002, 0.0005, 0.001)
#: Norm of the residual that smoothed L0 keeps, newtons: that of the noise, √m times 3.3 mN.
TOLERANCE_N: Final = 0.0033 * SUMS**0.5
STARTS: Final = ("cold", "warm")
#: Iterations behind the best objective and behind a warm start; those of a timed run, and how often it is repeated.
EXACT, WARM, TIMED, REPEATS = 500, 100, 20, 3
Values = npt.NDArray[np.floating[Any]]
#: Takes the number of iterations, the start, and what sees every iteration.
Run = Callable[[int, Values | None, Callable[[int, Values], None]], Any]


def evaluate(options: Options) -> Findings:
    """Return PSNR and gap of the objective for each method, start and budget, means over frames."""
    meshes = str(options.meshes) if options.meshes else None
    places = [(name, step) for name in OBJECTS for step in (QUICK_STEPS if options.quick else STEPS)]
    cells = [{"name": name, "meshes": meshes, "step": step, "seed": options.seed} for name, step in places]
    rows = _best(measure_cells(measure, cells, options, "solvers", jobs=1))
    return Findings(
        "Solvers: ADMM and smoothed L0 against FISTA at equal time",
        rows,
        _notes(rows, len(cells), options),
        [Picture("solvers", _CAPTION, lambda: _draw(rows))],
    )


_CAPTION: Final = (
    "Mean PSNR of single images from a cold start against the time each method was given. Higher and further left is "
    "better; FISTA and ADMM have the same minimum."
)


def _best(found: list[Row]) -> list[Row]:
    """Return the rows: of each method, start and budget, the setting of the best mean PSNR over frames."""
    rows: dict[tuple[str, ...], Row] = {}
    for key in found[0]:
        method, setting, start, budget = key.split("|")
        group = [each[key] for each in found]
        gaps = [each["gap"] for each in group if each["gap"] is not None]
        row = {
            "method": method,
            "start": start,
            "in_time_of": int(budget),
            "ms": round(float(np.mean([each["ms"] for each in group])), 2),
            "iterations": int(np.median([each["iterations"] for each in group])),
            "setting": setting,
            "gap": float(f"{np.mean(gaps):.2g}") if gaps else None,
            **beside(float(np.mean([each["psnr_db"] for each in group])), None),
        }
        best = rows.setdefault((method, start, budget), row)
        if row["ours"] > best["ours"]:
            rows[method, start, budget] = row
    return sorted(rows.values(), key=lambda row: (row["start"], row["in_time_of"]))


def measure(*, name: str, meshes: str | None, step: int, seed: int) -> Row:
    """Return time, iterations, PSNR and gap of one frame by ``method|setting|start|budget``.

    All are the plain NumPy forms with the same operators in float64, timed in turn in this process.
    """
    true = true_force(name, meshes, 1)[step - 1 : step + 1]
    felt = felt_force(true, seed, step).astype(np.float64)
    phi = sbhe(SIDE * SIDE, SUMS, selection="uniform", seed=phi_seed(seed, 0))
    psi = haar_tensor(SIDE, SIDE)
    before, sums_n = (phi.forward(each.reshape(-1)).astype(np.float64) for each in felt)
    solve = partial(fista, phi, psi, penalty_n=PENALTY, lipschitz=phi.norm_squared)
    warm = solve(before, iterations=WARM)
    best = objective(phi, psi, sums_n, solve(sums_n, iterations=EXACT, start=warm), PENALTY)

    def judged(s: Values) -> tuple[float, float]:
        level = psnr_db(np.maximum(psi.adjoint(s), 0), true[1])
        return level, objective(phi, psi, sums_n, s, PENALTY) / best - 1

    runs = _runs(phi, psi, sums_n)
    cost_s = _costs_s(runs)
    told: Row = {}
    for (method, setting), run in runs.items():
        counts = {budget: max(1, round(budget * cost_s["FISTA"] / cost_s[method])) for budget in BUDGETS}
        for start, given in zip(STARTS, (None, warm), strict=True):
            seen: dict[int, tuple[float, float]] = {}
            if method != "smoothed L0":
                run(max(counts.values()), given, _noting(seen, set(counts.values()), judged))
            elif given is not None:
                continue  # it begins from the least-squares solution
            for budget, count in counts.items():
                if method == "smoothed L0":  # how fast σ falls depends on how many steps there are
                    seen[count] = judged(run(count, None, _ignore))
                level, gap = seen[count]
                told[f"{method}|{setting}|{start}|{budget}"] = {
                    "ms": 1e3 * count * cost_s[method],
                    "iterations": count,
                    "psnr_db": level,
                    "gap": None if method == "smoothed L0" else gap,
                }
    return told


def _runs(phi: Operator, psi: Basis, sums_n: Values) -> dict[tuple[str, str], Run]:
    """Return what runs each method with each of its settings."""
    norm = phi.norm_squared

    def stepped(ratio: float) -> Run:
        return lambda count, start, observe: fista(
            phi,
            psi,
            sums_n,
            penalty_n=PENALTY,
            lipschitz=ratio * norm,
            iterations=count,
            start=start,
            observe=observe,
        )

    def coupled(ratio: float) -> Run:
        return lambda count, start, observe: admm(
            phi,
            psi,
            sums_n,
            penalty_n=PENALTY,
            iterations=count,
            coupling=ratio * norm,
            start=start,
            observe=observe,
        )

    def smoothed(smallest_n: float) -> Run:
        return lambda count, _start, _observe: _smoothed(phi, psi, sums_n, smallest_n, count)

    return {
        ("FISTA", "L = 2B (paper)"): stepped(2.0),
        ("FISTA, exact step", "L = B"): stepped(1.0),
        **{("ADMM", f"ρ = {ratio:g} B"): coupled(ratio) for ratio in COUPLINGS},
        **{("smoothed L0", f"σ to {1e3 * smallest:g} mN"): smoothed(smallest) for smallest in SMALLEST_N},
    }


def _smoothed(phi: Operator, psi: Basis, sums_n: Values, smallest_n: float, count: int) -> Values:
    """Return smoothed L0's result with σ falling so fast that some `count` steps bring it to its last."""
    inner = 3 if count >= 9 else 1
    turns = max(1, round(count / inner))
    widest = 2 * float(np.abs(psi.forward(phi.adjoint(sums_n).reshape(SIDE, SIDE))).max()) / phi.norm_squared
    # The loop runs while σ is above its last: a hair less than `turns` shrinkages would leave one more.
    shrink = min(0.99, (smallest_n / widest) ** (1 / turns) * (1 - 1e-9))
    return smoothed_l0(phi, psi, sums_n, tolerance_n=TOLERANCE_N, smallest_n=smallest_n, shrink=shrink, inner=inner)


def _costs_s(runs: dict[tuple[str, str], Run]) -> dict[str, float]:
    """Return the least time of one iteration of each method, all taking turns."""
    least: dict[str, float] = {}
    for _ in range(REPEATS):
        for (method, _setting), run in runs.items():
            started_s = time.perf_counter()
            run(TIMED, None, _ignore)
            spent_s = (time.perf_counter() - started_s) / TIMED
            least[method] = min(spent_s, least.get(method, spent_s))
    return least


def _noting(
    seen: dict[int, tuple[float, float]], wanted: set[int], judged: Callable[[Values], tuple[float, float]]
) -> Callable[[int, Values], None]:
    """Return an observer that judges the estimates of the iterations that are wanted."""

    def observe(iteration: int, estimate: Values) -> None:
        if iteration in wanted:
            seen[iteration] = judged(estimate)

    return observe


def _ignore(iteration: int, estimate: Values) -> None:
    """Observe nothing."""


def _notes(rows: list[Row], frames: int, options: Options) -> list[str]:
    at = 20
    cold, warm = (
        _ranking([row for row in rows if row["start"] == start and row["in_time_of"] == at]) for start in STARTS
    )
    return [
        objects_note(options),
        (
            f"Means over {frames} frames, {SUMS} sums, tensor Haar, λ = {PENALTY:g} N for FISTA and ADMM. Plain NumPy "
            "forms with the same operators, times from the same process; each runs as many iterations as fit the time "
            "of so many of the paper's FISTA."
        ),
        (
            "ADMM may choose its coupling ρ, and smoothed L0 its last σ, for each budget by the mean result; FISTA "
            "chooses nothing. A gap is (F - F*) / F* of the objective; smoothed L0 has another one."
        ),
        (
            f"In the time of {at} iterations, from a cold start: {cold}; from the frame before: {warm}. The paper "
            "reports that it found FISTA faster, without numbers. ADMM profits from ΦΨ(ΦΨ)ᵀ = B I, which makes its "
            "linear systems closed forms; with a contourlet, or any Ψ that is not orthonormal, it has none."
        ),
    ]


def _ranking(rows: list[Row]) -> str:
    """Return methods and their PSNR, the best first."""
    ranked = sorted(rows, key=lambda row: -row["ours"])
    return ", ".join(f"{row['method']} {row['ours']:.2f} dB" for row in ranked)


def _draw(rows: list[Row]) -> Any:
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for row in rows:
        if row["start"] == "cold":
            across, up = curves.setdefault(row["method"], ([], []))
            across.append(row["ms"])
            up.append(row["ours"])
    return draw_curves(curves, "time, ms", "PSNR, dB")
