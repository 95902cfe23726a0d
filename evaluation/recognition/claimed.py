"""Figures of the paper's claims on recognition: accuracies, and labels of the running classifier, in percent."""

from statistics import mean
from typing import Final

from evaluation.observations import OBJECTS, TAXELS
from evaluation.recognition.accuracy import measure_accuracy
from evaluation.recognition.printed import ACCURACIES, FULL, ONE_PERCENT, THREE_PERCENT
from evaluation.recognition.sixteen import measure_sixteen
from evaluation.result import Finding, Options, Row, grouped
from evaluation.result_cache import measure_cells

#: Splits of the observations, one for each draw of Φ, and draws of the running classifier, without --draws.
DRAWS: Final = 5
LIVE_DRAWS: Final = 2
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
    draws = options.draws_or(DRAWS)
    runs = {name: 1 if name == "all taxels" else draws for name in SIGNALS}
    calls = [
        {"kind": kind, "size": size, "draw": draw if kind == "sbhe" else 0, "splits": [draw]}
        | {"development": parts[0], "validation": parts[1], **options.shared}
        for name, (kind, size, parts) in SIGNALS.items()
        for draw in range(runs[name])
    ]
    found = iter(measure_cells(measure_accuracy, calls, options, "classification"))
    ours = {name: mean(100 * next(found)["accuracy"][0] for _ in range(count)) for name, count in runs.items()}
    printed = {name: ACCURACIES.get(signal) for name, signal in SIGNALS.items()}
    figures = {name: Finding(ours[name], runs[name], printed[name]) for name in SIGNALS}
    for sums, sensor in (("64 sums", "all taxels"), ("64 sums", "64 taxels"), ("16 sums", "16 taxels")):
        of_sums, of_sensor = printed[sums], printed[sensor]
        difference = None if of_sums is None or of_sensor is None else of_sums - of_sensor
        figures[f"{sums} - {sensor}"] = Finding(ours[sums] - ours[sensor], runs[sensor], difference)
    return figures


def _labels(options: Options) -> dict[str, Finding]:
    extent = {"touches": OBJECTS, "per_object": 100} if options.quick else {"touches": 3 * OBJECTS, "per_object": 600}
    cells: list[Row] = [
        {"stroke": "press", "sums": sums, "samples": 1, "draw": draw, "seed": options.seed, **extent}
        for sums in (64, 16)
        for draw in range(options.draws_or(LIVE_DRAWS))
    ]
    found = measure_cells(measure_sixteen, cells, options, "live")
    groups = grouped((cell | each for cell, each in zip(cells, found, strict=True)), "sums")
    return {
        f"live, {sums} sums": Finding(
            100 * mean(each["held"] for each in group), extent["touches"] * len(group), ACCURACIES["sbhe", sums, FULL]
        )
        for (sums,), group in groups.items()
    }
