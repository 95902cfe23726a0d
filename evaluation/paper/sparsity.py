"""Table I: how many coefficients of a touch are above 0.001 N, of five objects and four bases."""

from typing import Final

import numpy as np
from scipy import fft

from evaluation.paper.pictures import draw_counts
from evaluation.paper.runs import OBJECTS, SIDE, true_force
from evaluation.printed import printed_value
from evaluation.result import Options, Picture, Result, Row, beside
from evaluation.result_cache import measure_cells
from evaluation.solvers.pursuit import basis_pursuit
from reconstructor.bases import wavelet_basis
from reconstructor.kernels.contourlet import CompiledContourlet
from touch.trajectory import ACQUISITION_OBJECTS

#: τ of the paper's approximate sparsity, newtons.
THRESHOLD_N: Final = 0.001
#: The form of each basis that gives the golf ball's row: separable, all levels along both directions.
FORMS: Final = {"haar": "haar-tensor", "d4": "d4-tensor", "dct": "dct", "contourlet": "contourlet"}
#: Every how many steps are counted: for the contourlet fewer, because basis pursuit takes long.
STRIDES: Final = {"haar": 1, "d4": 1, "dct": 1, "contourlet": 20}
QUICK_STRIDES: Final = {"haar": 10, "d4": 10, "dct": 10, "contourlet": 300}
#: Relative gap at which basis pursuit ends; measured once, counts differ by 1 between it and a tenth.
PURSUIT_ERROR: Final = 1e-2
CAPTION: Final = (
    "Mean number of coefficients above 0.001 N over the trajectory: bars are ours, black marks the paper's. Fewer is "
    "better."
)


def evaluate(options: Options) -> Result:
    """Return Table I: rows of mean and largest count for each basis and object."""
    strides = QUICK_STRIDES if options.quick else STRIDES
    meshes = options.shared["meshes"]
    cells = [
        {"name": name, "meshes": meshes, "basis": basis, "stride": strides[basis]}
        for name in OBJECTS
        for basis in FORMS
    ]
    rows = []
    for cell, counts in zip(cells, measure_cells(count, cells, options, "sparsity"), strict=True):
        name, basis = cell["name"], cell["basis"]
        for quantity in ("mean", "max"):
            printed = printed_value("sparsity", object=name, basis=basis, quantity=quantity)
            percent = round(100 * (counts[quantity] / printed - 1), 1) + 0.0  # no -0.0
            rows.append(
                {
                    "object": name,
                    "start": "exact" if ACQUISITION_OBJECTS[name].exact else "fitted",
                    "basis": basis,
                    "quantity": quantity,
                    **beside(counts[quantity], printed, digits=1),
                    "difference_percent": percent,
                }
            )
    title = "Table I: approximate sparsity of touches in four bases"
    return Result(title, rows, [Picture(CAPTION, lambda: draw_counts(rows))])


def count(*, name: str, meshes: str | None, basis: str, stride: int) -> Row:
    """Return mean and largest count of coefficients above τ in size over every `stride`-th step."""
    true = true_force(name, meshes, stride)
    if basis == "contourlet":
        psi = CompiledContourlet(SIDE, SIDE)
        found = [basis_pursuit(psi, each.astype(np.float64), relative_error=PURSUIT_ERROR) for each in true]
    elif basis == "dct":
        found = [fft.dctn(each.astype(np.float64), norm="ortho") for each in true]
    else:
        orthonormal = wavelet_basis(FORMS[basis], SIDE, SIDE)
        found = [orthonormal.forward(each.astype(np.float64)) for each in true]
    counts = [int(np.count_nonzero(np.abs(each) > THRESHOLD_N)) for each in found]
    return {"mean": float(np.mean(counts)), "max": max(counts)}
