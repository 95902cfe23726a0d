"""``skin evaluate rivals``: compressed sums against scans, coarse arrays and event-triggered taxels."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, Final

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Row
from evaluation.schemes.contenders import (
    DEFAULT_KBIT_PER_S,
    Touch,
    measure_events,
    measure_scan,
    measure_sums,
)
from evaluation.schemes.rival_notes import chosen_rules, notes
from evaluation.schemes.rival_pictures import pictures
from evaluation.schemes.scenes import OWN, SLIDES, recordings_in

Cell = dict[str, Any]
#: Thresholds in newtons and dead times in milliseconds that event-triggered taxels are tried with.
_THRESHOLDS_N: Final = (2e-3, 2.5e-3, 3e-3, 3.5e-3, 4e-3, 5e-3)
RULES: Final = (*((threshold_n, 1) for threshold_n in _THRESHOLDS_N), (3e-3, 10), (4e-3, 10))
#: Parts of the default skin's bits at which the curves are measured.
SHARES: Final = (0.125, 0.25, 0.5)
#: What is measured at all shares, and shown in the curves.
CURVES: Final = (*SLIDES, "golf ball at rest", "three boxes slapped on", "two boxes shaking")
CURVED: Final = ("sums, 16 bits", "sums, 8 bits", "scan, 10 bits", "scan, 10 bits, solved", "32 x 32, solved")

_CLOCKED: Final[dict[str, tuple[Callable[..., Row], Cell]]] = {
    "sums, 16 bits": (measure_sums, {"bits": 16, "receiver": "solved"}),
    "sums, 12 bits": (measure_sums, {"bits": 12, "receiver": "solved"}),
    "sums, 8 bits": (measure_sums, {"bits": 8, "receiver": "solved"}),
    "sums, 16 bits, noise known": (measure_sums, {"bits": 16, "receiver": "noise known"}),
    "sums, 8 bits, noise known": (measure_sums, {"bits": 8, "receiver": "noise known"}),
    "scan, 8 bits": (measure_scan, {"side": 64, "bits": 8, "receiver": "plain", "cells": "sensor"}),
    "scan, 10 bits": (measure_scan, {"side": 64, "bits": 10, "receiver": "plain", "cells": "sensor"}),
    "scan, 12 bits": (measure_scan, {"side": 64, "bits": 12, "receiver": "plain", "cells": "sensor"}),
    "scan, 16 bits": (measure_scan, {"side": 64, "bits": 16, "receiver": "plain", "cells": "sensor"}),
    "scan, 10 bits, solved": (measure_scan, {"side": 64, "bits": 10, "receiver": "solved", "cells": "sensor"}),
    "32 x 32": (measure_scan, {"side": 32, "bits": 10, "receiver": "plain", "cells": "sensor"}),
    "32 x 32, solved": (measure_scan, {"side": 32, "bits": 10, "receiver": "solved", "cells": "sensor"}),
    "32 x 32 means of 4 taxels, solved": (
        measure_scan,
        {"side": 32, "bits": 10, "receiver": "solved", "cells": "mean"},
    ),
    "16 x 16": (measure_scan, {"side": 16, "bits": 10, "receiver": "plain", "cells": "sensor"}),
}
_QUICK: Final = ("sums, 16 bits", "sums, 8 bits", "scan, 10 bits", "32 x 32, solved")


def evaluate(options: Options) -> Findings:
    """Measure every contender on every touch.

    Parameters
    ----------
    options : Options
        `recordings` adds the recorded touches; `quick` looks at three touches, cut short.
    """
    touches = list(_touches(options))
    measured = [*_clocked(touches, options), *_events(touches, options)]
    shown = [each for each in measured if each["share"] == 1.0 and "threshold_n" not in each] + chosen_rules(measured)
    order = [touch.words for touch in touches]
    rows = [_table_row(each) for each in sorted(shown, key=lambda each: order.index(each["touch"]))]
    return Findings(
        "Rivals on the same four classic buses, at the bits a second of the default skin",
        rows,
        notes(measured, options),
        pictures(measured, options),
    )


def _touches(options: Options) -> Iterator[Touch]:
    meshes = str(options.meshes) if options.meshes else None
    if options.quick:
        yield Touch("golf-ball", ticks=600, seed=options.seed)
        yield Touch("three boxes slapped on", ticks=400, seed=options.seed)
        yield Touch("golf-ball", ticks=600, noise_n=2e-3, seed=options.seed)
        return
    for name in (*SLIDES, *OWN):
        yield Touch(name, meshes=meshes, seed=options.seed)
    yield Touch("golf-ball", noise_n=0.5e-3, seed=options.seed)
    yield Touch("golf-ball", noise_n=2e-3, seed=options.seed)
    yield Touch("golf ball at rest", loss_ratio=0.01, seed=options.seed)
    for path in recordings_in(options.recordings):
        yield Touch(path, seed=options.seed)


def _clocked(touches: list[Touch], options: Options) -> list[Row]:
    """Measure what is sent by the clock, at the default's bits and, for the curves, at less."""
    found = []
    for measure in (measure_sums, measure_scan):
        labels, cells = [], []
        for touch in touches:
            for name, (how, settings) in _CLOCKED.items():
                if how is not measure or (options.quick and name not in _QUICK):
                    continue
                curve = name in CURVED and touch.name in CURVES and touch == Touch(touch.name, meshes=touch.meshes)
                for share in (*SHARES, 1.0) if curve else (1.0,):
                    labels.append({"touch": touch.words, "contender": name, "share": share})
                    cells.append({"touch": asdict(touch), **settings, "kbit_per_s": share * DEFAULT_KBIT_PER_S})
        results = measure_cells(measure, cells, options, f"rivals-{measure.__name__.removeprefix('measure_')}")
        found += [label | result for label, result in zip(labels, results, strict=True)]
    return found


def _events(touches: list[Touch], options: Options) -> list[Row]:
    """Measure event-triggered taxels under every rule."""
    labels, cells = [], []
    for touch in touches:
        for threshold_n, dead_ms in RULES[3:5] if options.quick else RULES:
            for receiver in ("plain", "solved"):
                label = f"events, {1e3 * threshold_n:g} mN, {dead_ms} ms" + ", solved" * (receiver == "solved")
                rule = {"threshold_n": threshold_n, "dead_ms": dead_ms, "receiver": receiver}
                labels.append({"touch": touch.words, "contender": label, "share": 1.0, **rule})
                cells.append({"touch": asdict(touch), **rule})
    results = measure_cells(measure_events, cells, options, "rivals-events")
    return [label | result for label, result in zip(labels, results, strict=True)]


def _table_row(found: Row) -> Row:
    """Return what is shown of a measurement, rounded."""
    shown = {"touch": found["touch"], "contender": found["contender"]}
    digits = {
        "kbit_per_s": 0,
        "rate_hz": 0,
        "load": 3,
        "load_peak": 3,
        "psnr_mean_db": 1,
        "psnr_least_db": 1,
        "psnr_peak_db": 1,
        "error_mn": 2,
        "touched_error_mn": 2,
        "latency_p99_ms": 2,
        "latency_worst_ms": 2,
        "longest_wrong_ms": 0,
    }
    return shown | {key: None if found[key] is None else round(found[key], places) for key, places in digits.items()}
