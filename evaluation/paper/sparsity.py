"""Table I: how many coefficients of a touch are above 0.001 N, for four bases and five objects."""

from typing import Final

import numpy as np

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Picture, Row, beside, refuse_draws
from evaluation.paper.notes import objects_note
from evaluation.paper.pictures import draw_counts
from evaluation.paper.printed import TABLE_ONE
from evaluation.paper.runs import OBJECTS, SIDE, true_force
from evaluation.paper.tolerance import within
from evaluation.solvers.pursuit import basis_pursuit
from reconstructor.bases import make_basis
from reconstructor.kernels.contourlet import CompiledContourlet
from touch.trajectory import ACQUISITION_OBJECTS

#: τ of the paper's approximate sparsity, newtons.
THRESHOLD_N: Final = 0.001
#: The form of each basis that gives the golf ball's row: separable, all levels along both directions.
FORMS: Final = {"haar": "haar-tensor", "d4": "d4-tensor", "dct": "dct", "contourlet": "contourlet"}
#: Every how many steps basis pursuit is run; every step counts for the others.
PURSUIT_STRIDE: Final = 20
QUICK_STRIDE: Final = {"haar": 10, "d4": 10, "dct": 10, "contourlet": 300}
#: Relative gap at which basis pursuit ends; measured once, counts differ by 1 between it and a tenth.
PURSUIT_ERROR: Final = 1e-2
#: Aimed at: every orthonormal mean within 3 %, every contourlet mean within 10 %.
ORTHONORMAL_AIM, CONTOURLET_AIM = 3.0, 10.0


def evaluate(options: Options) -> Findings:
    """Return Table I: rows of mean and largest count for each basis and object.

    Raises
    ------
    InputError
        If draws are asked for: nothing is drawn.
    """
    refuse_draws(options, "sparsity")
    strides = QUICK_STRIDE if options.quick else dict.fromkeys(FORMS, 1) | {"contourlet": PURSUIT_STRIDE}
    meshes = str(options.meshes) if options.meshes else None
    places = [(name, basis) for name in OBJECTS for basis in FORMS]
    cells = [{"name": name, "meshes": meshes, "basis": basis, "stride": strides[basis]} for name, basis in places]
    rows = []
    for (name, basis), counts in zip(places, measure_cells(count, cells, options, "sparsity"), strict=True):
        for quantity, printed in zip(("mean", "max"), TABLE_ONE[basis][name], strict=True):
            ours = beside(counts[quantity], printed, digits=1)
            percent = round(100 * (counts[quantity] / printed - 1), 1) + 0.0  # no -0.0
            start = "exact" if ACQUISITION_OBJECTS[name].exact else "fitted"
            rows.append({"object": name, "start": start, "basis": basis, "quantity": quantity} | ours)
            rows[-1]["difference_percent"] = percent
    return Findings(
        "Table I: approximate sparsity of touches in four bases",
        rows,
        _notes(rows, options),
        [Picture("sparsity", _caption(rows), lambda: draw_counts(rows))],
    )


def _caption(rows: list[Row]) -> str:
    """Return what the plot shows, and which basis has the fewest coefficients of each object."""
    fewest: dict[str, list[str]] = {}
    for name in OBJECTS:
        group = [row for row in rows if (row["object"], row["quantity"]) == (name, "mean")]
        fewest.setdefault(min(group, key=lambda row: row["ours"])["basis"], []).append(name)
    told = "; ".join(f"{basis} for {', '.join(names)}" for basis, names in fewest.items())
    return (
        "Mean number of coefficients above 0.001 N over the trajectory: bars are ours, black marks the paper's. Fewer "
        f"is better. The fewest of ours: {told}."
    )


def count(*, name: str, meshes: str | None, basis: str, stride: int) -> Row:
    """Return mean and largest count of coefficients above τ in size over every `stride`-th step."""
    true = true_force(name, meshes, stride)
    if basis == "contourlet":
        psi = CompiledContourlet(SIDE, SIDE)
        found = [basis_pursuit(psi, each.astype(np.float64), relative_error=PURSUIT_ERROR) for each in true]
    else:
        orthonormal = make_basis(FORMS[basis], SIDE, SIDE)
        found = [orthonormal.forward(each.astype(np.float64)) for each in true]
    counts = [int(np.count_nonzero(np.abs(each) > THRESHOLD_N)) for each in found]
    return {"mean": float(np.mean(counts)), "max": max(counts)}


def _notes(rows: list[Row], options: Options) -> list[str]:
    means = [row | {"difference": row["difference_percent"]} for row in rows if row["quantity"] == "mean"]
    exact = [row for row in rows if row["start"] == "exact" and row["basis"] != "contourlet"]
    orthonormal = [row for row in means if row["basis"] != "contourlet"]
    contourlet = [row for row in means if row["basis"] == "contourlet"]
    notes = [
        objects_note(options),
        within(exact, 0.0, what="golf ball, orthonormal bases", unit="coefficients", least_share=1),
        within(orthonormal, ORTHONORMAL_AIM, what="all objects, orthonormal bases, means", unit="%", least_share=1),
        within(contourlet, CONTOURLET_AIM, what="contourlet, means", unit="%", least_share=1),
        (
            "Contourlet coefficients are those of least ‖s‖₁ with Ψs = x (basis pursuit; filters 'pkva', 2⁵ bands), "
            f"at every {QUICK_STRIDE['contourlet'] if options.quick else PURSUIT_STRIDE}th step."
        ),
    ]
    if options.quick:
        notes.append("A quick look: every 10th step, every 300th for the contourlet.")
    return notes
