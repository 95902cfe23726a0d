"""The paper's figures on images: PSNR over time, sample tactile images, convergence from a cold start."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Picture, Row, beside, refuse_draws
from evaluation.paper.columns import QUICK_STRIDE, STRIDE
from evaluation.paper.notes import objects_note, quick_note
from evaluation.paper.pictures import draw_curves, draw_images, draw_series
from evaluation.paper.printed import SAMPLE_RECONSTRUCTED_DB, SAMPLE_SENSOR_DB, TABLE_TWO
from evaluation.paper.runs import (
    PENALTY_N,
    RECONSTRUCTIONS,
    SIDE,
    Method,
    cell,
    felt_force,
    measure,
    phi_seed,
    true_force,
)
from reconstructor.fista import fista, largest_eigenvalue
from reconstructor.kernels.contourlet import CompiledContourlet
from skin.psnr import psnr_db
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

SUMS: Final = (1365, 1024, 819)
#: The step of the images: in the middle of the slide. The paper does not say which it shows.
STEP: Final = 2000
#: Steps before the step of the sample image, from which its start comes.
RUN_IN, QUICK_RUN_IN = 200, 30
SHOWN: Final = (20, 50, 100)
#: The last is where convergence is measured against.
LONGEST: Final = 400
#: When the first taxel is touched, and when the slide begins, ms.
TOUCHED_MS, SLIDES_MS = 100, 1100


def evaluate(options: Options) -> Findings:
    """Return the numbers behind the figures, and the figures.

    Raises
    ------
    InputError
        If draws are asked for: a figure is of one.
    """
    refuse_draws(options, "figures")
    stride = (QUICK_STRIDE if options.quick else STRIDE)["contourlet"]
    methods = [Method("sbhe", sums, "contourlet", 20) for sums in SUMS]
    cells = [cell("clamp", method, options, stride=stride, series=True) for method in methods]
    found = measure_cells(measure, cells, options, RECONSTRUCTIONS)
    series = {f"{sums} sums": np.array(each["psnr_db"]) for sums, each in zip(SUMS, found, strict=True)}
    sample, sample_db = _sample(options)
    converged = _convergence(options)
    rows = [*_series_rows(series, stride), *_sample_rows(sample_db), *_convergence_rows(converged)]
    pictures = [
        Picture("psnr-over-time", _OVER_TIME, lambda: draw_series(series, stride)),
        Picture("sample-images", _SAMPLE, lambda: draw_images(sample)),
        Picture("convergence", _CONVERGENCE, lambda: _draw_convergence(converged)),
        Picture("convergence-images", _CONVERGENCE_IMAGES, lambda: draw_images(_shown(converged))),
    ]
    notes = [
        objects_note(options),
        f"Images are those of step {STEP}; the paper does not say which step it shows.",
        *_trend_notes(series, stride, converged),
    ]
    return Findings("Figures: PSNR over time, sample images, convergence", rows, notes + quick_note(options), pictures)


_OVER_TIME: Final = (
    "PSNR of the clamp's images over time, contourlet, 20 iterations, SBHE. Before the first touch there is only "
    "noise to rebuild; the numbers of both parts are in the rows."
)
_SAMPLE: Final = "The drill: true forces, the sensor signal, and the image from 1024 sums (contourlet, warm start)."
_CONVERGENCE: Final = "PSNR of one image of the clamp against the number of iterations, contourlet, started from zero."
_CONVERGENCE_IMAGES: Final = "The same image after some of its iterations, each with its PSNR."


def _series_rows(series: dict[str, npt.NDArray[np.float64]], stride: int) -> list[Row]:
    rows = []
    for sums, (name, values) in zip(SUMS, series.items(), strict=True):
        printed = TABLE_TWO["clamp", "sbhe", sums]["contourlet"]
        touched, slides = TOUCHED_MS // stride, SLIDES_MS // stride
        parts = (
            ("before the touch", values[: max(1, touched)], None),
            ("slide", values[slides:], None),
            ("all steps", values, printed.mean),
        )
        for part, each, paper in parts:
            rows.append({"figure": "PSNR over time, clamp", "what": f"{name}, {part}"} | beside(each.mean(), paper))
    return rows


def _sample(options: Options) -> tuple[dict[str, Force], tuple[float, float]]:
    """Return the true, felt and rebuilt image of the drill, and the PSNR of the last two, dB."""
    meshes = str(options.meshes) if options.meshes else None
    run_in = QUICK_RUN_IN if options.quick else RUN_IN
    true = true_force("drill", meshes, 1)[STEP - run_in : STEP + 1]
    felt = felt_force(true, options.seed, 0)
    phi, solver = Method("sbhe", 1024, "contourlet", 20).make(phi_seed(options.seed, 0))
    estimate, weights = solver.new_estimate(), np.ones(phi.shape[0], np.float32)
    for each in felt:
        solver.solve(estimate, phi.forward(each.reshape(-1)).astype(np.float32), weights)
    rebuilt = solver.deliver(estimate)
    rebuilt_db, sensor_db = (psnr_db(true[-1], image, FORCE_MAX_N) for image in (rebuilt, felt[-1]))
    images = {
        "true": true[-1],
        f"sensor, {sensor_db:.1f} dB": felt[-1],
        f"from 1024 sums, {rebuilt_db:.1f} dB": rebuilt,
    }
    return images, (rebuilt_db, sensor_db)


def _sample_rows(levels: tuple[float, float]) -> list[Row]:
    figure = {"figure": "sample images, drill"}
    return [
        figure | {"what": "rebuilt from 1024 sums"} | beside(levels[0], SAMPLE_RECONSTRUCTED_DB),
        figure | {"what": "sensor signal"} | beside(levels[1], SAMPLE_SENSOR_DB),
    ]


def _convergence(options: Options) -> dict[int, tuple[float, Force]]:
    """Return PSNR, dB, and image of the clamp after each number of iterations from zero."""
    true = true_force("clamp", str(options.meshes) if options.meshes else None, 1)[STEP]
    felt = felt_force(true, options.seed, 0)
    phi, _ = Method("sbhe", 1024, "contourlet", 1).make(phi_seed(options.seed, 0))
    psi = CompiledContourlet(SIDE, SIDE)
    found: dict[int, tuple[float, Force]] = {}

    def observe(iteration: int, coefficients: npt.NDArray[np.floating[Any]]) -> None:
        image = np.maximum(psi.adjoint(coefficients), 0).astype(np.float32)
        found[iteration] = psnr_db(true, image, FORCE_MAX_N), image

    fista(
        phi,
        psi,
        phi.forward(felt.reshape(-1)).astype(np.float64),
        penalty_n=PENALTY_N["sbhe", "contourlet"],
        lipschitz=2 * largest_eigenvalue(phi, psi),
        iterations=LONGEST,
        observe=observe,
    )
    return found


def _convergence_rows(found: dict[int, tuple[float, Force]]) -> list[Row]:
    figure = {"figure": "convergence from zero, clamp"}
    return [
        figure | {"what": f"{iteration} iterations"} | beside(found[iteration][0], None)
        for iteration in (*SHOWN, LONGEST)
    ]


def _draw_convergence(found: dict[int, tuple[float, Force]]) -> Any:
    curve = (list(found), [level for level, _ in found.values()])
    return draw_curves({"1024 sums": curve}, "iterations", "PSNR, dB")


def _shown(found: dict[int, tuple[float, Force]]) -> dict[str, Force]:
    return {f"{each} iterations, {found[each][0]:.1f} dB": found[each][1] for each in SHOWN}


def _trend_notes(
    series: dict[str, npt.NDArray[np.float64]], stride: int, found: dict[int, tuple[float, Force]]
) -> list[str]:
    """Return what the paper says of its curves, and what ours do."""
    before = [values[: max(1, TOUCHED_MS // stride)].mean() for values in series.values()]
    after = [values[SLIDES_MS // stride :].mean() for values in series.values()]
    order = "so is ours" if before == sorted(before) else "ours is not"
    later = "so is ours" if after == sorted(after, reverse=True) else "ours is not"
    return [
        (
            f"The paper's curve of fewer sums is the higher one before the touch: {order} "
            f"({_listed(before)} dB for {', '.join(map(str, SUMS))} sums); and the lower one during the slide: {later} "
            f"({_listed(after)} dB)."
        ),
        (
            "The paper's PSNR has converged after about 100 iterations from zero: ours is "
            f"{found[100][0]:.1f} dB there and {found[LONGEST][0]:.1f} dB after {LONGEST}."
        ),
    ]


def _listed(levels: Sequence[float]) -> str:
    return ", ".join(f"{each:.1f}" for each in levels)
