"""Figures of the paper's claims on images: their quality, and how long one takes."""

from itertools import product
from statistics import mean
from typing import Final, get_args

import numpy as np
import numpy.typing as npt

from evaluation.paper.figures import convergence
from evaluation.paper.runs import OBJECTS, RECONSTRUCTIONS, Method, cell, measure
from evaluation.paper.tables import (
    QUICK_STRIDES,
    QUICK_TIMED_STEPS,
    STRIDES,
    TABLE_ITERATIONS,
    TABLE_SUMS,
    TIMED_STEPS,
    measure_sensor,
    measure_times,
)
from evaluation.printed import BasisName, paper_psnr, printed_value, sensor_psnr
from evaluation.result import Finding, Options, Row
from evaluation.result_cache import measure_cells

#: Draws of Φ and of the noise, without --draws.
DRAWS: Final = 2
#: Iterations of an image from zero: the paper's images have then converged.
FROM_ZERO: Final = 100


def claimed(options: Options) -> dict[str, Finding]:
    """Return gains over the sensor and PSNR, dB, and images a second, by the words for each basis."""
    draws, bases = options.draws_or(DRAWS), get_args(BasisName)
    stride = QUICK_STRIDES if options.quick else {basis: STRIDES[basis, TABLE_ITERATIONS] for basis in bases}
    calls = [
        cell(name, Method("sbhe", TABLE_SUMS, basis, TABLE_ITERATIONS), options, draw=draw, stride=stride[basis])
        for basis, name, draw in product(bases, OBJECTS, range(draws))
    ]
    image_db = _means(measure_cells(measure, calls, options, RECONSTRUCTIONS), len(bases), len(OBJECTS), draws)
    sensed = [
        {"name": name, "draw": draw, "stride": stride["haar"], **options.shared}
        for name, draw in product(OBJECTS, range(draws))
    ]
    sensor_db = _means(measure_cells(measure_sensor, sensed, options, "sensor"), len(OBJECTS), draws)
    steps = QUICK_TIMED_STEPS if options.quick else TIMED_STEPS
    (times_ms,) = measure_cells(measure_times, [{**options.shared, "steps": steps}], options, "times", jobs=1)
    found, runs = {"from zero": Finding(convergence(options)[FROM_ZERO][0], 1)}, len(OBJECTS) * draws
    for basis, level_db in zip(bases, image_db, strict=True):
        cells = [{"object": name, "matrix": "sbhe", "basis": basis} for name in OBJECTS]
        printed_db = np.array([paper_psnr("compression", sums=TABLE_SUMS, **cell).mean for cell in cells])
        gain_db, printed_gain_db = level_db - sensor_db, printed_db - [sensor_psnr(name).mean for name in OBJECTS]
        printed_ms = mean(printed_value("iterations", "ms", iterations=TABLE_ITERATIONS, **cell) for cell in cells)
        found |= {
            f"gain {basis}": Finding(gain_db.mean(), runs, printed_gain_db.mean()),
            f"least gain {basis}": Finding(gain_db.min(), runs, printed_gain_db.min()),
            f"PSNR {basis}": Finding(level_db.mean(), runs, printed_db.mean()),
            f"rate {basis}": Finding(1e3 / times_ms[f"{basis} {TABLE_ITERATIONS}"], steps, 1e3 / printed_ms),
        }
    return found


def _means(found: list[Row], *shape: int) -> npt.NDArray[np.float64]:
    """Return the mean PSNR of each cell over its draws, the last axis of `shape`."""
    mean_db: npt.NDArray[np.float64] = np.array([each["mean"] for each in found]).reshape(shape).mean(axis=-1)
    return mean_db
