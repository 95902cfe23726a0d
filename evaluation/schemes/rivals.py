"""``skin evaluate rivals``: compressed sums against scans, coarse arrays and event-triggered taxels."""

from collections.abc import Iterator
from typing import Final

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Row, refuse_draws
from evaluation.schemes.contenders import Events, Scan, Sums, cell_of, measure_contender
from evaluation.schemes.rival_notes import chosen_rules, notes
from evaluation.schemes.rival_pictures import pictures
from evaluation.schemes.scenes import OWN, SLIDES, recordings_in
from evaluation.schemes.shown import Contender
from evaluation.schemes.touches import Touch

#: Thresholds in newtons and dead times in milliseconds that event-triggered taxels are tried with.
_THRESHOLDS_N: Final = (2e-3, 2.5e-3, 3e-3, 3.5e-3, 4e-3, 5e-3)
RULES: Final = (*((threshold_n, 1) for threshold_n in _THRESHOLDS_N), (3e-3, 10), (4e-3, 10))
_QUICK_RULES: Final = RULES[3:5]
#: Parts of the default skin's bits at which the curves are measured.
SHARES: Final = (0.125, 0.25, 0.5)
#: Touches that are measured at all shares, and who is.
CURVES: Final = (*SLIDES, "golf ball at rest", "three boxes slapped on", "two boxes shaking")
CURVED: Final[tuple[Contender, ...]] = (
    Sums(16),
    Sums(8),
    Scan(64, 10),
    Scan(64, 10, "solved"),
    Scan(32, 10, "solved"),
)
#: Who goes by the clock.
CLOCKED: Final[tuple[Contender, ...]] = (
    Sums(16),
    Sums(12),
    Sums(8),
    Sums(16, "noise known"),
    Sums(8, "noise known"),
    Scan(64, 8),
    Scan(64, 10),
    Scan(64, 12),
    Scan(64, 16),
    Scan(64, 10, "solved"),
    Scan(32, 10),
    Scan(32, 10, "solved"),
    Scan(32, 10, "solved", cells="mean"),
    Scan(16, 10),
)
_QUICK: Final[tuple[Contender, ...]] = (Sums(16), Sums(8), Scan(64, 10), Scan(32, 10, "solved"))
#: Columns of the table, and places after the point.
_DIGITS: Final = {
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


def evaluate(options: Options) -> Findings:
    """Measure every contender on every touch.

    Parameters
    ----------
    options : Options
        `recordings` adds the recorded touches; `quick` looks at three touches, cut short.

    Raises
    ------
    InputError
        If `draws` are given, or the recordings cannot be read.
    """
    refuse_draws(options, "rivals")
    touches = list(_touches(options))
    measured = [*_clocked(touches, options), *_events(touches, options)]
    clocked = [row | {"rule": None} for row in measured if row["share"] == 1.0 and row["family"] != "events"]
    shown = sorted(clocked + chosen_rules(measured), key=lambda row: touches.index(row["touch"]))
    return Findings(
        "Rivals on the same four classic buses, at the bits a second of the default skin",
        [_table_row(row) for row in shown],
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
    wanted = []
    for touch in touches:
        for contender in _QUICK if options.quick else CLOCKED:
            curve = contender in CURVED and touch.name in CURVES and touch.is_plain and touch.ticks is None
            wanted += [(contender, touch, share) for share in ((*SHARES, 1.0) if curve else (1.0,))]
    return _measured(wanted, options, "rivals-clocked")


def _events(touches: list[Touch], options: Options) -> list[Row]:
    """Measure event-triggered taxels under every rule."""
    rules = [
        Events(threshold_n, dead_ms, receiver)
        for threshold_n, dead_ms in (_QUICK_RULES if options.quick else RULES)
        for receiver in ("plain", "solved")
    ]
    return _measured([(rule, touch, 1.0) for touch in touches for rule in rules], options, "rivals-events")


def _measured(wanted: list[tuple[Contender, Touch, float]], options: Options, what: str) -> list[Row]:
    """Return what each row is of, in fields, and its figures."""
    results = measure_cells(measure_contender, [cell_of(*each) for each in wanted], options, what)
    return [
        {
            "touch": touch,
            "contender": contender,
            "name": contender.name,
            "family": contender.family,
            "receiver": contender.receiver,
            "share": share,
        }
        | result
        for (contender, touch, share), result in zip(wanted, results, strict=True)
    ]


def _table_row(found: Row) -> Row:
    """Return what is shown of a measurement, rounded."""
    shown = {"touch": found["touch"].words, "contender": found["name"], "rule": found["rule"]}
    return shown | {key: None if found[key] is None else round(found[key], digits) for key, digits in _DIGITS.items()}
