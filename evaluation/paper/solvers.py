"""ADMM and smoothed L0 against FISTA at equal time: why the paper chose FISTA (section V)."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Picture, Row, beside, refuse_draws
from evaluation.paper.contenders import PAPERS, PENALTY, STARTS, SUMS, Contender, Values, make_contenders
from evaluation.paper.notes import objects_note
from evaluation.paper.pictures import draw_curves
from evaluation.paper.runs import OBJECTS, SIDE, felt_force, phi_seed, true_force
from reconstructor.bases import haar_tensor
from reconstructor.fista import fista, objective
from skin.measurement import sbhe
from skin.psnr import psnr_db
from skin.taxel import FORCE_MAX_N

#: Budgets: the time of so many iterations of the paper's FISTA.
BUDGETS: Final = (5, 10, 20, 50, 100)
#: Steps that are solved: at the end of the press, and on the slide.
STEPS: Final = (800, 2500)
QUICK_STEPS: Final = (2500,)
#: Iterations behind the best objective and behind a warm start; those of a timed run, and how often it is repeated.
EXACT, WARM, TIMED, REPEATS = 500, 100, 20, 3


def evaluate(options: Options) -> Findings:
    """Return PSNR and gap of the objective for each method, start and budget, means over frames.

    Raises
    ------
    InputError
        If draws are asked for: all frames have one Φ.
    """
    refuse_draws(options, "solvers")
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
    rows: dict[tuple[str, str, int], Row] = {}
    for group in zip(*(each["runs"] for each in found), strict=True):
        first = group[0]
        gaps = [each["gap"] for each in group if each["gap"] is not None]
        row = {
            "method": first["method"],
            "start": first["start"],
            "in_time_of": first["in_time_of"],
            "ms": round(float(np.mean([each["ms"] for each in group])), 2),
            "iterations": int(np.median([each["iterations"] for each in group])),
            "setting": first["setting"],
            "gap": float(f"{np.mean(gaps):.2g}") if gaps else None,
            **beside(float(np.mean([each["psnr_db"] for each in group])), None),
        }
        best = rows.setdefault((row["method"], row["start"], row["in_time_of"]), row)
        if row["ours"] > best["ours"]:
            rows[row["method"], row["start"], row["in_time_of"]] = row
    return sorted(rows.values(), key=lambda row: (row["start"], row["in_time_of"]))


def measure(*, name: str, meshes: str | None, step: int, seed: int) -> Row:
    """Return ``runs`` of one frame: a row with time, iterations, PSNR and gap for each contender, start and budget.

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
        image = np.maximum(psi.adjoint(s), 0).astype(np.float32)
        return psnr_db(true[1], image, FORCE_MAX_N), objective(phi, psi, sums_n, s, PENALTY) / best - 1

    contenders = make_contenders(phi, psi, sums_n)
    cost_s = _costs_s(contenders)
    runs: list[Row] = []
    for each in contenders:
        counts = {budget: max(1, round(budget * cost_s[PAPERS] / cost_s[each.method])) for budget in BUDGETS}
        for start in each.starts:
            estimates = each.run(set(counts.values()), warm if start == "warm" else None)
            for budget, count in counts.items():
                level_db, gap = judged(estimates[count])
                runs.append(
                    {
                        "method": each.method,
                        "setting": each.setting,
                        "start": start,
                        "in_time_of": budget,
                        "ms": 1e3 * count * cost_s[each.method],
                        "iterations": count,
                        "psnr_db": level_db,
                        "gap": gap if each.same_objective else None,
                    }
                )
    return {"runs": runs}


def _costs_s(contenders: Sequence[Contender]) -> dict[str, float]:
    """Return the least time of one iteration of each method, all taking turns."""
    least: dict[str, float] = {}
    for _ in range(REPEATS):
        for each in contenders:
            started_s = time.perf_counter()
            each.run({TIMED}, None)
            spent_s = (time.perf_counter() - started_s) / TIMED
            least[each.method] = min(spent_s, least.get(each.method, spent_s))
    return least


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
