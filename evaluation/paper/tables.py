"""Tables II and III: PSNR from 1365, 1024 and 819 sums with 20 iterations, and from 1024 sums with 20, 10 and 5."""

import time
from collections.abc import Sequence
from itertools import islice, product
from typing import Final, NamedTuple, get_args

import numpy as np

from evaluation.paper.pictures import draw_differences
from evaluation.paper.runs import (
    OBJECTS,
    RECONSTRUCTIONS,
    Method,
    cell,
    felt_force,
    measure,
    phi_seed,
    sums_of,
    true_force,
)
from evaluation.paper.runs import summary as psnr_summary
from evaluation.printed import SENSOR, BasisName, Matrix, Psnr, paper_psnr, paper_value, sensor_psnr
from evaluation.result import Options, Picture, Result, Row, beside
from evaluation.result_cache import measure_cells
from skin.psnr import psnr_series_db

SUMS: Final = (1365, 1024, 819)
ITERATIONS: Final = (20, 10, 5)
#: Sums of Table III, iterations of Table II.
TABLE_SUMS, TABLE_ITERATIONS = 1024, 20
#: Draws of Φ and of the noise that are averaged, without --draws; of the noiselet in Table III fewer, because the
#: noiselet only shows of which Φ the paper's table is.
DRAWS: Final = 5
NOISELET_DRAWS: Final = 1
#: Every how many steps are rebuilt. Fewer iterations need a nearer step as their start, at least with contourlets;
#: every 4th step in place of every step moves the clamp's mean by 0.04 dB (SBHE, 1024 sums, 20 iterations).
STRIDES: Final[dict[tuple[BasisName, int], int]] = {
    **{("haar", iterations): 1 for iterations in ITERATIONS},
    ("contourlet", 20): 4,
    ("contourlet", 10): 2,
    ("contourlet", 5): 1,
}
QUICK_STRIDES: Final[dict[BasisName, int]] = {"haar": 10, "contourlet": 20}
#: Steps that are timed, one after the other in the middle of the slide, and those before them that do not count.
TIMED_STEPS, QUICK_TIMED_STEPS, UNTIMED_STEPS = 200, 20, 5
TIMED_FROM: Final = 2000


class Cell(NamedTuple):
    """A cell of a table: the columns that name it, what is measured, over how many draws, and the paper's number."""

    name: str
    labels: Row
    method: Method
    draws: int
    printed: Psnr


def compression(options: Options) -> Result:
    """Return Table II: a row for each object, Φ, m and basis, and one for each object's sensor signal."""
    draws = options.draws_or(DRAWS)
    cells = [
        Cell(
            name,
            {"object": name, "matrix": matrix, "sums": sums, "basis": basis},
            Method(matrix, sums, basis, TABLE_ITERATIONS),
            draws,
            paper_psnr("compression", object=name, matrix=matrix, sums=sums, basis=basis),
        )
        for name, basis, sums, matrix in product(OBJECTS, get_args(BasisName), SUMS, get_args(Matrix))
    ]
    rows = _rows(cells, options) + _sensor_rows(options, draws)
    return _result("Table II: quality of the images from fewer sums, 20 iterations", rows)


def iterations(options: Options) -> Result:
    """Return Table III: a row for each object, basis, number of iterations and kind of Φ."""
    draws = {"sbhe": options.draws_or(DRAWS), "noiselet": options.draws_or(NOISELET_DRAWS)}
    cells = [
        Cell(
            name,
            {"object": name, "matrix": matrix, "basis": basis, "iterations": count},
            Method(matrix, TABLE_SUMS, basis, count),
            draws[matrix],
            # Of SBHE, as the paper says; its numbers stand beside the noiselet's, too.
            paper_psnr("iterations", object=name, matrix="sbhe", basis=basis, iterations=count),
        )
        for name, basis, count, matrix in product(OBJECTS, get_args(BasisName), ITERATIONS, get_args(Matrix))
    ]
    rows = _rows(cells, options)
    timed = {**options.shared, "steps": QUICK_TIMED_STEPS if options.quick else TIMED_STEPS}
    (times_ms,) = measure_cells(measure_times, [timed], options, "times", jobs=1)
    for row in rows:
        row.update(dict.fromkeys(("ms", "images_per_s")))
        if row["matrix"] == "sbhe":
            row["ms"] = times_ms[f"{row['basis']} {row['iterations']}"]
            row["images_per_s"] = round(1e3 / row["ms"], 2)
        labels = {key: row[key] for key in ("object", "matrix", "basis", "iterations")}
        row["paper_ms"] = paper_value("iterations", "ms", **labels)
    return _result("Table III: quality and time with fewer iterations, 1024 sums", rows)


def _result(title: str, rows: list[Row]) -> Result:
    caption = (
        f"PSNR of every cell of {title.partition(':')[0]}, ours against the paper's; on the diagonal both are equal. A "
        "point is the mean over the draws of Φ, and its bar spans twice their standard deviation."
    )
    return Result(title, rows, [Picture(caption, lambda: draw_differences(rows))])


def _rows(cells: Sequence[Cell], options: Options) -> list[Row]:
    """Measure every draw of every cell; objects come first in `cells`, so that a process keeps its trajectory."""

    def stride(method: Method) -> int:
        return QUICK_STRIDES[method.basis] if options.quick else STRIDES[method.basis, method.iterations]

    calls = [
        cell(each.name, each.method, options, draw=draw, stride=stride(each.method))
        for each in cells
        for draw in range(each.draws)
    ]
    results = iter(measure_cells(measure, calls, options, RECONSTRUCTIONS))
    return [each.labels | psnr_columns(list(islice(results, each.draws)), each.printed) for each in cells]


def _sensor_rows(options: Options, draws: int) -> list[Row]:
    stride = QUICK_STRIDES["haar"] if options.quick else 1
    calls = [
        {"name": name, "draw": draw, "stride": stride, **options.shared} for name in OBJECTS for draw in range(draws)
    ]
    results = iter(measure_cells(measure_sensor, calls, options, "sensor"))
    labels = {"matrix": SENSOR, "sums": 4096, "basis": ""}
    return [
        {"object": name, **labels} | psnr_columns(list(islice(results, draws)), sensor_psnr(name)) for name in OBJECTS
    ]


def psnr_columns(found: list[Row], printed: Psnr) -> Row:
    """Return the columns of one cell from its draws: the mean beside the paper's, the spread over draws, the range.

    ``least`` and ``most`` are means of the draws'.
    """
    mean, least, most = (np.array([each[key] for each in found]) for key in ("mean", "least", "most"))
    return beside(float(mean.mean()), printed.mean) | {
        "spread": round(float(mean.std()), 2),
        "least": round(float(least.mean()), 2),
        "least_spread": round(float(least.std()), 2),
        "paper_least": printed.least,
        "most": round(float(most.mean()), 2),
        "most_spread": round(float(most.std()), 2),
        "paper_most": printed.most,
    }


def measure_sensor(*, name: str, meshes: str | None, stride: int, seed: int, draw: int) -> Row:
    """Return mean, least and largest PSNR of the sensor signal itself, dB."""
    true = true_force(name, meshes, stride)
    return psnr_summary(psnr_series_db(true, felt_force(true, seed, draw)))


def measure_times(*, meshes: str | None, seed: int, steps: int) -> Row:
    """Return the median time of one image of the clamp, ms, from its sums to newtons, for each basis and iterations.

    All take turns at every step, so that other work on the machine slows all alike.
    """
    true = true_force("clamp", meshes, 1)[TIMED_FROM : TIMED_FROM + UNTIMED_STEPS + steps]
    felt = felt_force(true, seed, 0)
    runners = {}
    for basis, count in product(get_args(BasisName), ITERATIONS):
        phi, solver = Method("sbhe", TABLE_SUMS, basis, count).make(phi_seed(seed, 0))
        runners[f"{basis} {count}"] = (solver, solver.new_estimate(), sums_of(phi, felt))
    weights = np.ones(TABLE_SUMS, np.float32)
    spent_ms: dict[str, list[float]] = {name: [] for name in runners}
    for step in range(len(true)):
        for name, (solver, estimate, sums_n) in runners.items():
            started_s = time.perf_counter()
            solver.solve(estimate, sums_n[step], weights)
            solver.deliver(estimate)
            spent_ms[name].append(1e3 * (time.perf_counter() - started_s))
    return {name: round(float(np.median(each[UNTIMED_STEPS:])), 3) for name, each in spent_ms.items()}
