"""``skin evaluate rivals``: compressed sums against scans, coarse arrays and event-triggered taxels."""

from collections.abc import Iterator
from itertools import product
from typing import Final

import numpy as np

from evaluation.result import Options, Result, Row, grouped
from evaluation.result_cache import measure_cells
from evaluation.schemes.comparison_pictures import EVENT_FAMILIES, pictures
from evaluation.schemes.default_skin import default_kbit_per_s
from evaluation.schemes.fresh_scenes import FIELDS, POSED
from evaluation.schemes.scenes import OWN, SHAKING, SLAP, SLIDES, Touch, random_touch, recordings_in
from evaluation.schemes.schemes import Adaptive, Events, FilteredEvents, Scan, Scheme, Sums, measure_scheme

#: Thresholds in newtons and dead times in milliseconds that event-triggered taxels are tried with.
_THRESHOLDS_N: Final = (2e-3, 2.5e-3, 3e-3, 3.5e-3, 4e-3, 5e-3)
RULES: Final = (*((threshold_n, 1) for threshold_n in _THRESHOLDS_N), (3e-3, 10), (4e-3, 10))
_QUICK_RULES: Final = RULES[3:5]
#: Thresholds in newtons that filtered taxels are tried with.
FILTERED_N: Final = (0.2e-3, 0.3e-3, 0.5e-3, 0.8e-3, 1.2e-3)
_QUICK_FILTERED_N: Final = FILTERED_N[2:3]
#: Parts of the default skin's bits at which the curves are measured.
SHARES: Final = (0.125, 0.25, 0.5)
#: Touches that are measured at all shares, and who is.
CURVES: Final = (*SLIDES, "golf ball at rest", SLAP, SHAKING)
CURVED: Final[tuple[Scheme, ...]] = (Sums(16), Sums(8), Scan(64, 10), Scan(64, 10, "solved"), Scan(32, 10, "solved"))
#: Who goes by the clock.
CLOCKED: Final[tuple[Scheme, ...]] = (
    Sums(16),
    Sums(12),
    Sums(8),
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
_QUICK: Final[tuple[Scheme, ...]] = (Sums(16), Sums(8), Scan(64, 10), Scan(32, 10, "solved"))
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


def evaluate(options: Options) -> Result:
    """Measure every scheme on every touch.

    Parameters
    ----------
    options : Options
        `recordings` adds the recorded touches; `quick` looks at three touches, cut short.

    Raises
    ------
    InputError
        If the recordings cannot be read.
    """
    known = list(_touches(options))
    touches = known + list(_fresh_touches(options))
    measured = [*_adaptive(touches, options), *_clocked(touches, options), *_events(touches, options)]
    clocked = [row | {"rule": None} for row in measured if row["share"] == 1.0 and row["family"] not in EVENT_FAMILIES]
    shown = sorted(clocked + chosen_rules(measured, known), key=lambda row: touches.index(row["touch"]))
    return Result(
        "Baselines on the same four classic buses, at the bits a second of the default skin",
        [_table_row(row) for row in shown],
        pictures(measured, options),
        wins_and_losses(shown),
    )


def _touches(options: Options) -> Iterator[Touch]:
    meshes = options.shared["meshes"]
    if options.quick:
        yield Touch("golf-ball", ticks=600, seed=options.seed)
        yield Touch(SLAP, ticks=400, seed=options.seed)
        yield Touch("golf-ball", ticks=600, noise_n=2e-3, seed=options.seed)
        return
    for name in (*SLIDES, *OWN):
        yield Touch(name, meshes=meshes, seed=options.seed)
    yield Touch("golf-ball", noise_n=0.5e-3, seed=options.seed)
    yield Touch("golf-ball", noise_n=2e-3, seed=options.seed)
    yield Touch("golf ball at rest", loss_ratio=0.01, seed=options.seed)
    for path in recordings_in(options.recordings):
        yield Touch(path, seed=options.seed)


def _fresh_touches(options: Options) -> Iterator[Touch]:
    """Yield the touches that no rule is chosen on, random ones last."""
    if options.quick:
        return
    meshes, seed = options.shared["meshes"], options.seed
    for name in (*POSED, *FIELDS):
        yield Touch(name, meshes=meshes, seed=seed)
    yield Touch("golf-ball", noise_n=4e-3, seed=seed)
    yield Touch("golf ball at rest", loss_ratio=0.05, seed=seed)
    for name in ("golf-ball", "granola-box"):
        yield Touch(name, noise="coloured", meshes=meshes, seed=seed)
        yield Touch(name, noise="heavy-tailed", meshes=meshes, seed=seed)
        yield Touch(name, noise="common-mode", meshes=meshes, seed=seed)
        yield Touch(name, drift_n_per_s=1e-3, meshes=meshes, seed=seed)
        yield Touch(name, stuck=20, meshes=meshes, seed=seed)
    for number in range(options.scenes):
        yield random_touch(number, options.scene_seed, meshes, seed)


def _adaptive(touches: list[Touch], options: Options) -> list[Row]:
    return _measured([(Adaptive(), touch, 1.0) for touch in touches], options, "rivals-adaptive")


def _clocked(touches: list[Touch], options: Options) -> list[Row]:
    """Measure what is sent by the clock, at the default's bits and, for the curves, at less."""
    wanted = []
    for touch in touches:
        for scheme in _QUICK if options.quick else CLOCKED:
            curve = scheme in CURVED and touch.name in CURVES and touch.is_plain and touch.ticks is None
            wanted += [(scheme, touch, share) for share in ((*SHARES, 1.0) if curve else (1.0,))]
    return _measured(wanted, options, "rivals-clocked")


def _events(touches: list[Touch], options: Options) -> list[Row]:
    """Measure event-triggered taxels, as they are and filtered, under every rule."""
    rules: list[Scheme] = [
        Events(threshold_n, dead_ms, receiver)
        for threshold_n, dead_ms in (_QUICK_RULES if options.quick else RULES)
        for receiver in ("plain", "solved")
    ]
    rules += [
        FilteredEvents(threshold_n, receiver)
        for threshold_n in (_QUICK_FILTERED_N if options.quick else FILTERED_N)
        for receiver in ("plain", "solved")
    ]
    return _measured([(rule, touch, 1.0) for touch in touches for rule in rules], options, "rivals-events")


def _measured(wanted: list[tuple[Scheme, Touch, float]], options: Options, what: str) -> list[Row]:
    """Return what each row is of, in fields, and its figures."""
    cells: list[Row] = [{"scheme": scheme, "touch": touch, "share": share} for scheme, touch, share in wanted]
    results = measure_cells(measure_scheme, cells, options, what)
    return [
        {**cell, "name": cell["scheme"].name, "family": cell["scheme"].family, "receiver": cell["scheme"].receiver}
        | result
        for cell, result in zip(cells, results, strict=True)
    ]


def chosen_rules(measured: list[Row], known: list[Touch]) -> list[Row]:
    """Return for every touch and receiver the row of the rule tuned to it, and that of the one rule for all touches.

    ``rule`` is ``tuned to this touch`` or ``one for all``; the latter is the best one on the touches `known`.
    """
    found = []
    for family, receiver in product(EVENT_FAMILIES, ("plain", "solved")):
        rules = [row for row in measured if row["family"] == family and row["receiver"] == receiver]
        best = _one_rule([row for row in rules if row["touch"] in known])
        for touch in dict.fromkeys(row["touch"] for row in rules):
            mine = [row for row in rules if row["touch"] == touch]
            fits = [row for row in mine if row["kbit_per_s"] <= default_kbit_per_s()] or mine
            found.append(max(fits, key=lambda row: float(row["psnr_mean_db"])) | {"rule": "tuned to this touch"})
            found += [row | {"rule": "one for all"} for row in mine if row["name"] == best]
    return found


def _one_rule(rules: list[Row]) -> str:
    """Return the scheme whose rule has the best mean PSNR over all touches, with whatever bits it then takes."""
    rows_of = {str(name): rows for (name,), rows in grouped(rules, "name").items()}
    return max(rows_of, key=lambda name: float(np.mean([row["psnr_mean_db"] for row in rows_of[name]])))


def wins_and_losses(shown: list[Row]) -> str:
    """Return a line for each touch: adaptive sums against the scheme with the best PSNR and that with the least error.

    A rule of events counts as it was tuned to the touch. A line that begins with ``LOSS`` names where adaptive sums
    are worse.
    """
    lines = []
    for touch in dict.fromkeys(row["touch"] for row in shown):
        mine = [row for row in shown if row["touch"] == touch]
        ours = next(row for row in mine if row["family"] == "adaptive")
        others = [row for row in mine if row["family"] != "adaptive"]
        best = max(others, key=lambda row: float(row["psnr_mean_db"]))
        gain_db = ours["psnr_mean_db"] - best["psnr_mean_db"]
        worse = [] if gain_db > 0 else ["PSNR"]
        said = f"{gain_db:+.1f} dB to {best['name']}"
        if ours["touched_error_mn"] is not None:
            nearest = min(others, key=lambda row: float(row["touched_error_mn"]))
            worse += [] if ours["touched_error_mn"] < nearest["touched_error_mn"] else ["touched error"]
            said += f"; touched {ours['touched_error_mn']:.2f} mN, {nearest['touched_error_mn']:.2f} {nearest['name']}"
        worse += [] if ours["kbit_per_s"] < best["kbit_per_s"] else ["bits"]
        said += f"; {ours['kbit_per_s']:.0f} kbit/s, {best['kbit_per_s']:.0f} {best['name']}"
        lines.append(f"{'LOSS in ' + ', '.join(worse) if worse else 'win'}: {touch.words}: {said}")
    return "Adaptive sums against the best other scheme of each touch:\n" + "\n".join(lines)


def _table_row(found: Row) -> Row:
    """Return what is shown of a measurement, rounded."""
    shown = {"touch": found["touch"].words, "scheme": found["name"], "rule": found["rule"]}
    return shown | {key: None if found[key] is None else round(found[key], digits) for key, digits in _DIGITS.items()}
