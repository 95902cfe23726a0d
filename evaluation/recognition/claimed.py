"""Figures of the paper's claims on recognition: accuracies, and labels of the running classifier, in percent."""

from statistics import mean, pstdev
from typing import Final

from evaluation.observations import OBJECTS, TAXELS
from evaluation.recognition.accuracy import FULL, ONE_PERCENT, THREE_PERCENT, measure_accuracy
from evaluation.recognition.classification import cells_of, printed_accuracy
from evaluation.recognition.sixteen import measure_sixteen
from evaluation.result import Finding, Options, Row, grouped
from evaluation.result_cache import measure_cells, measured_rows

#: Draws of the running classifier, without --draws; `classification` has its own of the observations.
DRAWS: Final = 10
#: Signals whose accuracy is measured: kind, size, and development and validation set.
SIGNALS: Final = {
    "64 sums": ("sbhe", 64, FULL),
    "16 sums": ("sbhe", 16, FULL),
    "16 sums, 3 %": ("sbhe", 16, THREE_PERCENT),
    "16 sums, 1 %": ("sbhe", 16, ONE_PERCENT),
    "all taxels": ("averaged", TAXELS, FULL),
    "64 taxels": ("averaged", 64, FULL),
    "16 taxels": ("averaged", 16, FULL),
}


def claimed(options: Options) -> dict[str, Finding]:
    """Return accuracies, differences of accuracies, and parts of the cycles with the right label."""
    return _accuracies(options) | _labels(options)


def _accuracies(options: Options) -> dict[str, Finding]:
    cells = {name: cells_of(*signal, options) for name, signal in SIGNALS.items()}
    calls = [cell for each in cells.values() for cell in each]
    found = iter(measure_cells(measure_accuracy, calls, options, "classification"))
    percent = {name: [100 * one for _ in each for one in next(found)["accuracy"]] for name, each in cells.items()}
    ours = {name: mean(each) for name, each in percent.items()}
    printed = {name: printed_accuracy(*signal) for name, signal in SIGNALS.items()}
    figures = {name: Finding(ours[name], len(each), printed[name], pstdev(each)) for name, each in percent.items()}
    for sums, sensor in (("64 sums", "all taxels"), ("64 sums", "64 taxels"), ("16 sums", "16 taxels")):
        of_sums, of_sensor = printed[sums], printed[sensor]
        difference = None if of_sums is None or of_sensor is None else of_sums - of_sensor
        figures[f"{sums} - {sensor}"] = Finding(ours[sums] - ours[sensor], len(percent[sums]), difference)
    return figures


def _labels(options: Options) -> dict[str, Finding]:
    extent = {"touches": OBJECTS, "per_object": 100} if options.quick else {"touches": 3 * OBJECTS, "per_object": 600}
    cells: list[Row] = [
        {"stroke": "press", "sums": sums, "samples": 1, "draw": draw, "seed": options.seed + draw, **extent}
        for sums in (64, 16)
        for draw in range(options.draws_or(DRAWS))
    ]
    figures = {}
    for (sums,), group in grouped(measured_rows(measure_sixteen, cells, options, "live"), "sums").items():
        percent = [100 * each["held"] for each in group]
        runs, paper = extent["touches"] * len(group), printed_accuracy("sbhe", sums, FULL)
        figures[f"live, {sums} sums"] = Finding(mean(percent), runs, paper, pstdev(percent))
    return figures
