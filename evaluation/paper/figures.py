"""The paper's figures on images: PSNR over time, sample tactile images, convergence from a cold start."""

from typing import Final

import numpy as np

from evaluation.paper.pictures import draw_curves, draw_images, draw_series
from evaluation.paper.runs import (
    RECONSTRUCTIONS,
    SIDE,
    Decibels,
    Method,
    cell,
    felt_force,
    measure,
    phi_seed,
    rebuilt_images,
    true_force,
)
from evaluation.paper.tables import QUICK_STRIDES, STRIDES, SUMS, TABLE_ITERATIONS, TABLE_SUMS
from evaluation.printed import paper_psnr, paper_value
from evaluation.result import Options, Picture, Result, Row, beside
from evaluation.result_cache import measure_cells
from reconstructor.checks import Values
from reconstructor.fista import fista, largest_eigenvalue
from reconstructor.kernels.contourlet import CompiledContourlet
from reconstructor.settings import PAPER_CONTOURLET
from skin.psnr import psnr_db
from touch.contact import Force

#: The step of the images: in the middle of the slide. The paper does not say which it shows.
STEP: Final = 2000
#: Steps before the step of the sample image, from which its start comes.
RUN_IN, QUICK_RUN_IN = 200, 30
SHOWN: Final = (20, 50, 100)
#: The last is where convergence is measured against.
LONGEST: Final = 400
#: When the first taxel is touched, and when the slide begins, ms.
TOUCHED_MS, SLIDES_MS = 100, 1100


def evaluate(options: Options) -> Result:
    """Return the numbers behind the figures, and the figures."""
    stride = QUICK_STRIDES["contourlet"] if options.quick else STRIDES["contourlet", TABLE_ITERATIONS]
    methods = [Method("sbhe", sums, "contourlet", TABLE_ITERATIONS) for sums in SUMS]
    cells = [cell("clamp", method, options, stride=stride, series=True) for method in methods]
    found = measure_cells(measure, cells, options, RECONSTRUCTIONS)
    series = {f"{sums} sums": np.array(each["psnr_db"]) for sums, each in zip(SUMS, found, strict=True)}
    true, felt, rebuilt = _sample(options)
    rebuilt_db, sensor_db = psnr_db(true, rebuilt), psnr_db(true, felt)
    sample = {"true": true, f"sensor, {sensor_db:.1f} dB": felt, f"from 1024 sums, {rebuilt_db:.1f} dB": rebuilt}
    converged = convergence(options)
    curve = {f"{TABLE_SUMS} sums": (list(converged), [level for level, _ in converged.values()])}
    shown = {f"{each} iterations, {converged[each][0]:.1f} dB": converged[each][1] for each in SHOWN}
    rows = [
        *_series_rows(series, stride),
        *(
            _row("sample images, drill", what, level_db, paper_value("figures", what=what))
            for what, level_db in (("rebuilt from 1024 sums", rebuilt_db), ("sensor signal", sensor_db))
        ),
        *(
            _row("convergence from zero, clamp", f"{count} iterations", converged[count][0], None)
            for count in (*SHOWN, LONGEST)
        ),
    ]
    pictures = [
        Picture(
            "PSNR of the clamp's images over time, contourlet, 20 iterations, SBHE. Before the first touch there is "
            "only noise to rebuild.",
            lambda: draw_series(series, stride),
        ),
        Picture(
            "The drill: true forces, the sensor signal, and the image from 1024 sums (contourlet, warm start).",
            lambda: draw_images(sample),
        ),
        Picture(
            "PSNR of one image of the clamp against the number of iterations, contourlet, started from zero.",
            lambda: draw_curves(curve, "iterations"),
        ),
        Picture(
            "The same image after some of its iterations, each with its PSNR.",
            lambda: draw_images(shown),
        ),
    ]
    return Result("Figures: PSNR over time, sample images, convergence", rows, pictures)


def _row(figure: str, what: str, ours_db: float, paper_db: float | None) -> Row:
    return {"figure": figure, "what": what, **beside(ours_db, paper_db)}


def _series_rows(series: dict[str, Decibels], stride: int) -> list[Row]:
    rows = []
    for sums, (name, levels) in zip(SUMS, series.items(), strict=True):
        printed = paper_psnr("compression", object="clamp", matrix="sbhe", sums=sums, basis="contourlet")
        parts = (
            ("before the touch", levels[: max(1, TOUCHED_MS // stride)], None),
            ("slide", levels[SLIDES_MS // stride :], None),
            ("all steps", levels, printed.mean),
        )
        rows += [_row("PSNR over time, clamp", f"{name}, {part}", each.mean(), paper) for part, each, paper in parts]
    return rows


def _sample(options: Options) -> tuple[Force, Force, Force]:
    """Return the true, felt and rebuilt image of the drill."""
    run_in = QUICK_RUN_IN if options.quick else RUN_IN
    true = true_force("drill", options.shared["meshes"], 1)[STEP - run_in : STEP + 1]
    felt = felt_force(true, options.seed, 0)
    phi, solver = Method("sbhe", TABLE_SUMS, "contourlet", TABLE_ITERATIONS).make(phi_seed(options.seed, 0))
    *_, rebuilt = rebuilt_images(phi, solver, felt)
    return true[-1], felt[-1], rebuilt


def convergence(options: Options) -> dict[int, tuple[float, Force]]:
    """Return PSNR, dB, and image of the clamp after each number of iterations from zero."""
    true = true_force("clamp", options.shared["meshes"], 1)[STEP]
    felt = felt_force(true, options.seed, 0)
    phi, _ = Method("sbhe", TABLE_SUMS, "contourlet", 1).make(phi_seed(options.seed, 0))
    psi = CompiledContourlet(SIDE, SIDE)
    found: dict[int, tuple[float, Force]] = {}

    def observe(iteration: int, coefficients: Values) -> None:
        image = np.maximum(psi.adjoint(coefficients), 0).astype(np.float32)
        found[iteration] = psnr_db(true, image), image

    fista(
        phi,
        psi,
        phi.forward(felt.reshape(-1)).astype(np.float64),
        penalty_n=PAPER_CONTOURLET.penalty_n,
        lipschitz=2 * largest_eigenvalue(phi, psi),
        iterations=LONGEST,
        observe=observe,
    )
    return found
