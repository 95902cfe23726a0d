"""Figures of the paper's claims on hardware: the default skin on simulated buses, converters and wires."""

from dataclasses import asdict
from pathlib import Path
from statistics import mean
from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.plan import plan
from bandwidth.wiring import wiring
from dbc.contract import Contract
from dbc.dictionary import window_s
from evaluation.result import Finding, Options, Row
from evaluation.result_cache import measure_cells
from evaluation.schemes import frontend
from evaluation.schemes.judge import quality
from evaluation.schemes.scan import run_scan
from evaluation.schemes.scenes import SLIDE_TICKS, SLIDES, Touch
from evaluation.schemes.schemes import SCAN_BITS
from evaluation.schemes.sums import run_sums
from skin.layout import Layout, load_layout
from skin.psnr import decibels
from skin.taxel import FORCE_MAX_N

#: Milliseconds of a slide for a quick look.
QUICK_TICKS: Final = 1200
#: Front ends that are compared: a converter for each taxel, and one of as many bits for each sum.
DIGITAL: Final = frontend.Effect("digital", is_digital=True)
ANALOGUE: Final = {
    "analogue, same λ": frontend.Effect("same λ", bits=SCAN_BITS, keeps_penalty=True),
    "analogue": frontend.Effect("λ that fits the noise of each", bits=SCAN_BITS),
}


def claimed(options: Options) -> dict[str, Finding]:
    """Return cycles and bits of the default skin, PSNR of front ends, dB, and ratios of wires."""
    return _skin(options) | _converters(options) | _wires()


def _skin(options: Options) -> dict[str, Finding]:
    asked = {"ticks": QUICK_TICKS if options.quick else SLIDE_TICKS, **options.shared}
    found = measure_cells(measure_skin, [{"name": name, **asked} for name in SLIDES], options, "skin")
    layout, cycles = load_layout(), sum(each["cycles"] for each in found)
    complete = sum(each["complete"] for each in found) / cycles
    return {
        "live gain": Finding(mean(each["image_db"] - each["sensor_db"] for each in found), cycles),
        "complete cycles": Finding(complete / layout.sync.round_s, cycles),
        "carried cycles": Finding(mean_rate_hz(layout), 1),
        "carried cycles of 64": Finding(mean_rate_hz(load_layout(Path("recognition"))), 1),
        "compression": Finding(layout.taxels.count / layout.measurement.sums, 1),
        "bits": Finding(mean(each["scan_kbit_per_s"] / each["sums_kbit_per_s"] for each in found), cycles),
    }


def mean_rate_hz(layout: Layout) -> float:
    """Return how often in a second the buses of a layout carry all sums, with random data."""
    return min(bus.max_rate_hz_random for bus in plan(Contract.from_layout(layout))) / layout.sync.turns


def _converters(options: Options) -> dict[str, Finding]:
    asked = {
        "speed": frontend.QUICK_SPEED if options.quick else frontend.SPEED,
        "size": load_layout().measurement.block_size,
    }
    cells = [{**options.shared, **asked, "effect": asdict(each)} for each in (DIGITAL, *ANALOGUE.values())]
    digital, *analogue = measure_cells(frontend.measure, cells, options, "front ends")
    skin = load_layout(Path("analogue"))
    return {
        name: Finding(each["psnr_db"] - digital["psnr_db"], each["frames"])
        for name, each in zip(ANALOGUE, analogue, strict=True)
    } | {"conversions": Finding(skin.taxels.count / skin.measurement.sums, 1)}


def _wires() -> dict[str, Finding]:
    layout = load_layout()
    phi, taxels = layout.phi(), layout.taxels
    star_m = star_length_m(phi.taxels_of_blocks, taxels.columns, taxels.pitch_m)
    return {"chains": Finding(taxels.count / phi.blocks, 1), "star": Finding(star_m / wiring(layout).wires_m, 1)}


def measure_skin(*, name: str, ticks: int, meshes: str | None, seed: int) -> Row:
    """Return what the default skin makes of a slide: PSNR, cycles, and kbit/s beside those of a scan as often.

    Returns
    -------
    dict
        ``image_db`` of the image in use at each millisecond, ``sensor_db``, ``cycles``, ``complete`` of them with every
        frame in the window, ``sums_kbit_per_s`` and ``scan_kbit_per_s``.
    """
    layout = load_layout()
    contract, touch = Contract.from_layout(layout), Touch(name, ticks=ticks, meshes=meshes, seed=seed)
    scene = touch.load()
    run = run_sums(contract, scene.counts, idle_counts=touch.idle())
    errors_n2 = np.mean((scene.felt_n.astype(np.float64) - scene.true_n) ** 2, axis=1)
    late_ns = run.latency_ns.reshape(len(run.sums_n), -1).max(axis=1)
    scan = run_scan(scene.felt_n, SCAN_BITS, 1 / layout.sync.round_s)
    return {
        "image_db": quality(scene.true_n, run.images(contract))["psnr_mean_db"],
        "sensor_db": float(decibels(errors_n2, FORCE_MAX_N).mean()),
        "cycles": len(run.sums_n),
        "complete": int(np.count_nonzero(run.valid.all(axis=1) & (late_ns <= 1e9 * window_s(layout)))),
        "sums_kbit_per_s": run.sent.traffic()["kbit_per_s"],
        "scan_kbit_per_s": scan.sent.traffic()["kbit_per_s"],
    }


def star_length_m(taxels_of_blocks: npt.NDArray[np.integer], columns: int, pitch_m: float) -> float:
    """Return the length of a wire to every taxel from the middle of its block's taxels, metres.

    Parameters
    ----------
    taxels_of_blocks : array of int, shape (blocks, B)
        Taxel numbers, row by row of the grid.
    """
    places = np.stack(np.divmod(taxels_of_blocks, columns), axis=-1) * pitch_m
    away = places - places.mean(axis=1, keepdims=True)
    return float(np.linalg.norm(away, axis=-1).sum())
