"""Table II: PSNR of the images from 1365, 1024 and 819 sums, for two kinds of Φ and two bases, 20 iterations."""

from typing import Any, Final, get_args

import numpy as np

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Picture, Row
from evaluation.paper.columns import AIMS, DRAWS, QUICK_STRIDE, STRIDE, cell_name, psnr_columns
from evaluation.paper.notes import CONVENTION, objects_note, quick_note
from evaluation.paper.pictures import draw_differences
from evaluation.paper.printed import SENSOR, TABLE_TWO, BasisName, Matrix
from evaluation.paper.runs import OBJECTS, RECONSTRUCTIONS, Method, cell, felt_force, measure, true_force
from evaluation.paper.tolerance import outside, within
from skin.psnr import psnr_db
from skin.taxel import FORCE_MAX_N

SUMS: Final = (1365, 1024, 819)
ITERATIONS: Final = 20
#: The sensor's tolerance, dB: all objects must be within it.
SENSOR_AIM_DB: Final = 0.15


def evaluate(options: Options) -> Findings:
    """Return Table II: a row for each object, Φ, m and basis, and one for each object's sensor signal."""
    draws = options.draws or (1 if options.quick else DRAWS)
    strides = QUICK_STRIDE if options.quick else STRIDE
    # Objects outside, so that a process keeps the trajectory it has.
    places = [
        (name, matrix, sums, basis)
        for name in OBJECTS
        for basis in get_args(BasisName)
        for sums in SUMS
        for matrix in get_args(Matrix)
    ]
    cells = [
        cell(name, Method(matrix, sums, basis, ITERATIONS), options, draw=draw, stride=strides[basis])
        for name, matrix, sums, basis in places
        for draw in range(draws)
    ]
    results = iter(measure_cells(measure, cells, options, RECONSTRUCTIONS))
    rows = []
    for name, matrix, sums, basis in places:
        place = {"object": name, "matrix": matrix, "sums": sums, "basis": basis}
        found = [next(results) for _ in range(draws)]
        rows.append(place | psnr_columns(found, TABLE_TWO[name, matrix, sums][basis]))
    sensor = measure_cells(measure_sensor, _sensor_cells(options, draws, strides["haar"]), options, "sensor")
    for number, name in enumerate(OBJECTS):
        place = {"object": name, "matrix": "none: sensor signal", "sums": 4096, "basis": ""}
        rows.append(place | psnr_columns(sensor[number * draws : (number + 1) * draws], SENSOR[name]))
    return Findings(
        "Table II: quality of the images from fewer sums, 20 iterations",
        rows,
        _notes(rows, options, draws),
        [Picture("compression", _CAPTION, lambda: draw_differences(rows))],
    )


_CAPTION: Final = (
    "PSNR of every cell of Table II, ours against the paper's; on the diagonal both are equal. A point is the mean "
    "over the draws of Φ, and its bar spans twice their standard deviation."
)


def measure_sensor(*, name: str, meshes: str | None, stride: int, seed: int, draw: int) -> Row:
    """Return mean, least and largest PSNR of the sensor signal itself, dB."""
    true = true_force(name, meshes, stride)
    pairs = zip(felt_force(true, seed, draw), true, strict=True)
    found = np.array([psnr_db(each, felt, FORCE_MAX_N) for felt, each in pairs])
    return {"mean": float(found.mean()), "least": float(found.min()), "most": float(found.max())}


def _sensor_cells(options: Options, draws: int, stride: int) -> list[Row]:
    meshes = str(options.meshes) if options.meshes else None
    shared = {"meshes": meshes, "stride": stride, "seed": options.seed}
    return [{"name": name, "draw": draw, **shared} for name in OBJECTS for draw in range(draws)]


def _notes(rows: list[Row], options: Options, draws: int) -> list[str]:
    notes = [objects_note(options), CONVENTION]
    for (matrix, basis), (tolerance, share) in AIMS.items():
        group = [row for row in rows if (row["matrix"], row["basis"]) == (matrix, basis)]
        notes.append(within(group, tolerance, what=f"{matrix}, {basis}", unit="dB", least_share=share))
        far: Any = outside(group, tolerance, unit="dB", name=cell_name)
        notes += [far] if far else []
    sensor = [row for row in rows if not row["basis"]]
    notes.append(within(sensor, SENSOR_AIM_DB, what="sensor signal", unit="dB", least_share=1))
    notes.append(
        f"Means over draws of Φ and of the noise: {draws}. Spread is their standard deviation, least and most are "
        "means of each draw's extremes. The paper's numbers are those of one draw, printed to 0.1 dB."
    )
    if not options.quick:
        notes.append(
            f"Contourlets are rebuilt at every {STRIDE['contourlet']}th step, each started from the step rebuilt "
            "before. Measured once, every 4th step in place of every step moves the clamp's mean by 0.04 dB (SBHE, "
            "1024 sums)."
        )
    return notes + quick_note(options)
