"""``skin evaluate claims``: every claim of the paper's abstract and conclusion, and what is measured here."""

from dataclasses import asdict
from itertools import product
from pathlib import Path
from statistics import mean
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from bandwidth.plan import plan
from bandwidth.wiring import wiring
from classifier.descent import descend
from dbc.contract import Contract
from dbc.dictionary import window_s
from evaluation.bench.timing import race
from evaluation.observations import OBJECTS as CLASSES
from evaluation.paper.figures import convergence
from evaluation.paper.printed import RATE_HZ, SENSOR, TABLE_THREE, TABLE_TWO, BasisName
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
from evaluation.recognition.accuracy import measure_accuracy
from evaluation.recognition.printed import ACCURACIES, FULL, ONE_PERCENT, THREE_PERCENT
from evaluation.recognition.sixteen import measure_sixteen
from evaluation.result import Options, Result, Row, beside, grouped
from evaluation.result_cache import measure_cells
from evaluation.schemes import frontend
from evaluation.schemes.judge import quality
from evaluation.schemes.scan import run_scan
from evaluation.schemes.scenes import SLIDE_TICKS, TAXELS, Touch
from evaluation.schemes.sums import run_sums
from skin.layout import Layout, Taxels, load_layout
from skin.psnr import decibels
from skin.sources import OBJECT_GROUPS
from skin.taxel import FORCE_MAX_N

#: Draws of Φ and of the noise, and splits of the observations, one for each draw, without --draws.
IMAGE_DRAWS: Final = 2
RECOGNITION_DRAWS: Final = 5
LIVE_DRAWS: Final = 2
#: Milliseconds of a slide on simulated buses, for a quick look.
QUICK_TICKS: Final = 1200
#: Bits of a value of a scan: the converter's.
SCAN_BITS: Final = Taxels().adc_bits
#: Turns in which decisions are timed.
ROUNDS, QUICK_ROUNDS = 20, 5
#: Signals whose accuracy is measured: kind, size, and development and validation set.
SUMS_64: Final = ("sbhe", 64, FULL)
SUMS_16: Final = ("sbhe", 16, FULL)
ALL_TAXELS: Final = ("averaged", TAXELS, FULL)
COARSE_64: Final = ("averaged", 64, FULL)
COARSE_16: Final = ("averaged", 16, FULL)
SIGNALS: Final = (
    SUMS_64,
    SUMS_16,
    ("sbhe", 16, THREE_PERCENT),
    ("sbhe", 16, ONE_PERCENT),
    ALL_TAXELS,
    COARSE_64,
    COARSE_16,
)
#: Front ends that are compared: a converter for each taxel, and one of as many bits for each sum.
DIGITAL: Final = frontend.Effect("digital", is_digital=True)
ANALOGUE: Final = (
    frontend.Effect("same λ", bits=SCAN_BITS, keeps_penalty=True),
    frontend.Effect("λ that fits the noise of each", bits=SCAN_BITS),
)
#: Iterations of an image from zero: the paper's images have then converged.
FROM_ZERO: Final = 100
BEST: Final = "up to 98 % accuracy at 64:1"
LITTLE: Final = "high accuracy with much compression and little training"
Mode = Literal["offline", "live"]


class Claim(NamedTuple):
    """A claim in short words, and the command that shows more."""

    words: str
    command: str

    def row(self, quantity: str, ours: float, *, runs: int, paper: float | None = None, mode: Mode = "offline") -> Row:
        """Return a row of the table."""
        about = {"claim": self.words, "quantity": quantity}
        numbers = beside(float(ours), None if paper is None else round(float(paper), 2))
        return about | numbers | {"mode": mode, "runs": runs, "command": self.command}


def evaluate(options: Options) -> Result:
    """Return a row for each claim and quantity."""
    rows = [
        *_image_rows(options),
        *_rate_rows(options),
        *_skin_rows(options),
        *_accuracy_rows(options),
        *_label_rows(options),
        *_converter_rows(options),
        *_wire_rows(),
        _decision_row(options),
    ]
    rows = [row for group in grouped(rows, "claim").values() for row in group]
    note = (
        "paper: the number of the text, or of the table on which the claim rests, its over 80 % and under 60 % as 80 "
        "and 60; empty where the paper has none. "
        "offline: arrays, or arithmetic. live: the code of boards, frames, solver and classifier of the running skin, "
        "in one process; those of the default skin also on simulated buses. runs: trajectories, splits, cycles, "
        "images, touches or decisions behind the figure. Live images are ours: solver, and averages on the boards. "
        "Live labels are made as in the paper: its sixteen objects, drawn sums as features, one sample of a taxel in "
        "a cycle; their touches have our shapes, with meshes too. skin demo shows the images in real time, and with "
        "--objects paper --stroke press --layout recognition the sixteen, named from 64 rows that training chose."
    )
    return Result("Claims of the paper's abstract and conclusion", rows, note=note)


def _image_rows(options: Options) -> list[Row]:
    """Return the rows on the quality of images."""
    draws, bases = options.draws_or(IMAGE_DRAWS), get_args(BasisName)
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
    as_good = Claim("1024 sums are as good as all 4096 taxels", "skin evaluate compression")
    quarter = Claim("a quality signal from a fourth of its size", "skin evaluate compression")
    when_needed = Claim("full signal recovered when needed", "skin evaluate figures")
    rows, runs = [], len(OBJECTS) * draws
    for basis, level_db in zip(bases, image_db, strict=True):
        printed_db = np.array([TABLE_TWO[name, "sbhe", TABLE_SUMS][basis].mean for name in OBJECTS])
        printed_gain_db = printed_db - [SENSOR[name].mean for name in OBJECTS]
        gain_db, gain = level_db - sensor_db, f"PSNR of images - PSNR of sensor, {basis}"
        rows += [
            as_good.row(f"{gain}, mean of 5 objects, dB", gain_db.mean(), paper=printed_gain_db.mean(), runs=runs),
            as_good.row(f"{gain}, worst object, dB", gain_db.min(), paper=printed_gain_db.min(), runs=runs),
            quarter.row(f"PSNR of images, {basis}, dB", level_db.mean(), paper=printed_db.mean(), runs=runs),
        ]
    from_zero_db, _ = convergence(options)[FROM_ZERO]
    quantity = f"PSNR of a single image from zero, contourlet, {FROM_ZERO} iterations, clamp, dB"
    return [*rows, when_needed.row(quantity, from_zero_db, runs=1)]


def _means(found: list[Row], *shape: int) -> npt.NDArray[np.float64]:
    """Return the mean PSNR of each cell over its draws, the last axis of `shape`."""
    mean_db: npt.NDArray[np.float64] = np.array([each["mean"] for each in found]).reshape(shape).mean(axis=-1)
    return mean_db


def _rate_rows(options: Options) -> list[Row]:
    """Return the rows on images a second."""
    steps = QUICK_TIMED_STEPS if options.quick else TIMED_STEPS
    (times_ms,) = measure_cells(measure_times, [{**options.shared, "steps": steps}], options, "times", jobs=1)
    claim = Claim("4096 taxels at over 100 Hz", "skin evaluate iterations")
    printed_ms = {
        basis: mean(TABLE_THREE[name, basis, TABLE_ITERATIONS].ms for name in OBJECTS) for basis in get_args(BasisName)
    }
    return [
        claim.row(
            f"images a second, {basis}, {TABLE_ITERATIONS} iterations",
            1e3 / times_ms[f"{basis} {TABLE_ITERATIONS}"],
            paper=1e3 / paper_ms,
            runs=steps,
        )
        for basis, paper_ms in printed_ms.items()
    ]


def _accuracy_rows(options: Options) -> list[Row]:
    """Return the rows on recognition."""
    draws = options.draws_or(RECOGNITION_DRAWS)
    runs = {signal: 1 if signal == ALL_TAXELS else draws for signal in SIGNALS}
    calls = [
        {"kind": kind, "size": size, "draw": draw if kind == "sbhe" else 0, "splits": [draw]}
        | {"development": parts[0], "validation": parts[1], **options.shared}
        for (kind, size, parts), count in runs.items()
        for draw in range(count)
    ]
    found = iter(measure_cells(measure_accuracy, calls, options, "classification"))
    ours = {signal: mean(100 * next(found)["accuracy"][0] for _ in range(count)) for signal, count in runs.items()}
    command = "skin evaluate classification"
    best = Claim(BEST, command)
    little = Claim(LITTLE, command)
    full = Claim("accuracy as on the original signal", command)
    same = Claim("better than sensor signals of the same size", command)
    rows = [
        claim.row(
            f"accuracy, 16 objects, {signal[1]} sums, {words}, %", ours[signal], paper=ACCURACIES[signal], runs=draws
        )
        for claim, signal, words in (
            (best, SUMS_64, "60 % training"),
            (little, SUMS_16, "60 % training"),
            (little, ("sbhe", 16, THREE_PERCENT), "3 % training"),
            (little, ("sbhe", 16, ONE_PERCENT), "1 % training"),
        )
    ]
    for claim, sums, sensor, words in (
        (full, SUMS_64, ALL_TAXELS, "all 4096 taxels"),
        (same, SUMS_64, COARSE_64, "64 coarse taxels"),
        (same, SUMS_16, COARSE_16, "16 coarse taxels"),
    ):
        printed = ACCURACIES[sums] - ACCURACIES[sensor] if sensor in ACCURACIES else None
        quantity = f"accuracy of {sums[1]} sums - accuracy of {words}, points"
        rows.append(claim.row(quantity, ours[sums] - ours[sensor], paper=printed, runs=runs[sensor]))
    return rows


def _skin_rows(options: Options) -> list[Row]:
    """Return the rows of the default skin on simulated buses."""
    asked = {"ticks": QUICK_TICKS if options.quick else SLIDE_TICKS, **options.shared}
    found = measure_cells(measure_skin, [{"name": name, **asked} for name in OBJECTS], options, "skin")
    layout, cycles = load_layout(), sum(each["cycles"] for each in found)
    as_good = Claim("1024 sums are as good as all 4096 taxels", "skin evaluate rivals")
    fast = Claim("4096 taxels at over 100 Hz", "skin plan")
    less = Claim("less data is sent, faster acquisition", "skin evaluate rivals")
    gain_db = mean(each["image_db"] - each["sensor_db"] for each in found)
    complete_hz = layout.sync.rate_hz * sum(each["complete"] for each in found) / cycles
    most_hz, few_hz = (mean_rate_hz(each) for each in (layout, load_layout(Path("recognition"))))
    ratio = mean(each["scan_kbit_per_s"] / each["sums_kbit_per_s"] for each in found)
    bits = f"bits on the bus: scan of all taxels, {SCAN_BITS} bits / sums, {layout.encoding.sum_bits} bits"
    compression = layout.taxels.count / layout.measurement.sums
    return [
        as_good.row("PSNR of images - PSNR of sensor, 5 objects, dB", gain_db, runs=cycles, mode="live"),
        fast.row("complete cycles a second, simulated buses", complete_hz, paper=RATE_HZ, runs=cycles, mode="live"),
        fast.row("cycles a second that four buses of 1 Mbit/s carry", most_hz, paper=RATE_HZ, runs=1),
        less.row("taxels / sums", compression, paper=TAXELS / TABLE_SUMS, runs=1),
        less.row(bits, ratio, runs=cycles, mode="live"),
        Claim(less.words, "skin plan recognition").row(
            "cycles of 64 sums a second that one bus of 1 Mbit/s carries", few_hz, runs=1
        ),
    ]


def mean_rate_hz(layout: Layout) -> float:
    """Return the cycles a second that the buses of a layout carry with random data."""
    return min(bus.max_rate_hz_random for bus in plan(Contract.from_layout(layout)))


def _label_rows(options: Options) -> list[Row]:
    """Return the rows of the running classifier."""
    objects = len(OBJECT_GROUPS["paper"])
    extent = {"touches": objects, "per_object": 100} if options.quick else {"touches": 3 * objects, "per_object": 600}
    cells: list[Row] = [
        {"stroke": "press", "sums": sums, "samples": 1, "draw": draw, "seed": options.seed, **extent}
        for sums in (64, 16)
        for draw in range(options.draws_or(LIVE_DRAWS))
    ]
    found = [
        cell | each for cell, each in zip(cells, measure_cells(measure_sixteen, cells, options, "live"), strict=True)
    ]
    command = "skin evaluate recognition"
    best, little = Claim(BEST, command), Claim(LITTLE, command)
    rows = []
    for (sums,), group in grouped(found, "sums").items():
        claim = best if sums == SUMS_64[1] else little
        share = 100 * mean(each["held"] for each in group)
        quantity = f"cycles of a full press with the right label, {objects} objects, our shapes, {sums} sums, %"
        runs = extent["touches"] * len(group)
        rows.append(claim.row(quantity, share, paper=ACCURACIES["sbhe", sums, FULL], runs=runs, mode="live"))
    return rows


def _converter_rows(options: Options) -> list[Row]:
    """Return the rows on sums that are made before the converters."""
    asked = {
        "speed": frontend.QUICK_SPEED if options.quick else frontend.SPEED,
        "size": load_layout().measurement.block_size,
    }
    cells = [{**options.shared, **asked, "effect": asdict(each)} for each in (DIGITAL, *ANALOGUE)]
    digital, *analogue = measure_cells(frontend.measure, cells, options, "front ends")
    claim = Claim("compressed in hardware before transmission", "skin evaluate frontend")
    analogue_skin = load_layout(Path("analogue"))
    conversions = analogue_skin.taxels.count / analogue_skin.measurement.sums
    return [
        claim.row(
            f"PSNR with a {SCAN_BITS}-bit converter for each sum - for each taxel, {effect.words}, 5 objects, dB",
            each["psnr_db"] - digital["psnr_db"],
            runs=each["frames"],
        )
        for effect, each in zip(ANALOGUE, analogue, strict=True)
    ] + [
        claim.row(
            "conversions in a cycle, for each taxel / for each sum", conversions, paper=TAXELS / TABLE_SUMS, runs=1
        )
    ]


def _wire_rows() -> list[Row]:
    """Return the rows on wires; the figures are geometry."""
    layout = load_layout()
    phi, taxels = layout.phi(), layout.taxels
    claim = Claim("less wiring", "skin evaluate wiring")
    ratio = star_length_m(phi.taxels_of_blocks, taxels.columns, taxels.pitch_m) / wiring(layout).wires_m
    return [
        claim.row("taxels / chains of taxels", taxels.count / phi.blocks, runs=1),
        claim.row("length of a wire to each taxel from the middle of its block / length of the chains", ratio, runs=1),
    ]


def _decision_row(options: Options) -> Row:
    asked = {"rounds": QUICK_ROUNDS if options.quick else ROUNDS, "seed": options.seed}
    (times,) = measure_cells(measure_decisions, [asked], options, "decisions", jobs=1)
    claim = Claim("less processing", "skin bench classify")
    ratio = times["taxels_us"] / times["sums_us"]
    return claim.row("time of a decision: 4096 taxels / 64 sums", ratio, runs=asked["rounds"])


def measure_skin(*, name: str, ticks: int, meshes: str | None, seed: int) -> Row:
    """Return what the default skin makes of a slide: PSNR, cycles, and kbit/s beside those of a scan at its rate.

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
    scan = run_scan(scene.felt_n, SCAN_BITS, layout.sync.rate_hz)
    return {
        "image_db": quality(scene.true_n, run.images(contract))["psnr_mean_db"],
        "sensor_db": float(decibels(errors_n2, FORCE_MAX_N).mean()),
        "cycles": len(run.sums_n),
        "complete": int(np.count_nonzero(run.valid.all(axis=1) & (late_ns <= 1e9 * window_s(layout)))),
        "sums_kbit_per_s": run.sent.traffic()["kbit_per_s"],
        "scan_kbit_per_s": scan.sent.traffic()["kbit_per_s"],
    }


def measure_decisions(*, rounds: int, seed: int) -> Row:
    """Return the median time of one decision between the paper's objects, µs, from 64 sums and from 4096 taxels."""
    random, pairs = np.random.default_rng(seed), CLASSES * (CLASSES - 1) // 2

    def decision(size: int) -> Any:
        weights, biases, values = (random.standard_normal(shape) for shape in ((pairs, size), pairs, size))
        return lambda: descend(values, weights, biases, CLASSES)

    sums_s, taxels_s = race([decision(SUMS_64[1]), decision(TAXELS)], rounds)
    return {"sums_us": 1e6 * float(np.median(sums_s)), "taxels_us": 1e6 * float(np.median(taxels_s))}


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
