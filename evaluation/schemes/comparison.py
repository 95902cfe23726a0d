"""``skin evaluate rivals``: our sums against scans, coarse arrays and events of the same boards."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from statistics import mean, pstdev
from typing import Final

from canskin.errors import InputError
from evaluation.result import Options, Result, Row, grouped
from evaluation.result_cache import measured_rows
from evaluation.schemes.scenes import OWN, SLAP, Touch
from evaluation.schemes.schemes import (
    AVERAGED_SCAN,
    BEST_SCAN,
    COARSE_ARRAY,
    RAW_SCAN,
    THIN_SCAN,
    FilteredEvents,
    Scheme,
    Stepped,
    Sums,
    measure_scheme,
)
from skin.sources import object_label

OURS: Final = Stepped()
#: Thresholds in newtons that events are tried with.
EVENTS: Final = tuple(map(FilteredEvents, (0.2e-3, 0.3e-3, 0.5e-3, 0.8e-3)))
SCHEMES: Final[tuple[Scheme, ...]] = (
    OURS,
    Sums(),
    BEST_SCAN,
    AVERAGED_SCAN,
    RAW_SCAN,
    THIN_SCAN,
    COARSE_ARRAY,
    *EVENTS,
)
_QUICK: Final[tuple[Scheme, ...]] = (OURS, Sums(), BEST_SCAN, RAW_SCAN, COARSE_ARRAY, FilteredEvents(0.5e-3))
#: Those that scenes drawn at random are shown: the best of each kind. The largest threshold is for boxes that shake.
_DRAWN: Final[tuple[Scheme, ...]] = (OURS, Sums(), BEST_SCAN, *EVENTS[:-1])
#: Columns of the table, and places after the point.
DIGITS: Final = {
    "kbit_per_s": 0,
    "rate_hz": 0,
    "psnr_mean_db": 1,
    "touched_error_mn": 2,
    "latency_p99_ms": 2,
}


def evaluate(options: Options) -> Result:
    """Measure every scheme on every touch; with a `scene_seed` the best of each kind on scenes drawn at random.

    Parameters
    ----------
    options : Options
        `quick` looks at three touches, or at two drawn scenes, cut short.
    """
    if options.scene_seed is not None:
        return _evaluate_drawn(options, options.scene_seed)
    found = _measured(_touches(options), options, SCHEMES)
    slides = set(map(object_label, options.objects))
    together = means_of(found, slides, f"{len(slides)} slides") if len(slides) > 1 else []
    return _compared("Schemes", together + found)


def _measured(touches: Iterable[Touch], options: Options, schemes: Sequence[Scheme]) -> list[Row]:
    """Return the figures of every scheme on every touch, a row each; `_QUICK` schemes for a quick look."""
    shown = _QUICK if options.quick else schemes
    cells: list[Row] = [{"scheme": scheme, "touch": touch} for touch in touches for scheme in shown]
    return [
        {"touch": row["touch"].words, "scheme": row["scheme"].name, "receiver": row["receiver"], "psnr_spread_db": None}
        | {key: row[key] for key in DIGITS}
        for row in measured_rows(measure_scheme, cells, options, "rivals")
    ]


def _compared(title: str, found: list[Row]) -> Result:
    """Return the result of rows that were measured, rounded."""
    return Result(
        f"{title} on the same boards and four classic buses; scans and coarse arrays at the bits of the default skin",
        [row | {key: None if row[key] is None else round(row[key], DIGITS[key]) for key in DIGITS} for row in found],
    )


def _evaluate_drawn(options: Options, scene_seed: int) -> Result:
    """Measure steps, the default and their best rivals on scenes drawn at random."""
    count, ticks = (2, 400) if options.quick else (options.scenes, None)
    if not count:
        raise InputError("expected 1 drawn scene or more (--scenes), got 0")
    touches = [Touch(str(number), ticks=ticks, scene_seed=scene_seed, **options.shared) for number in range(count)]
    found = _measured(touches, options, _DRAWN)
    title = f"Schemes on {count} scenes drawn by seed {scene_seed}"
    return _compared(title, means_of(found, {touch.words for touch in touches}, "all scenes") + found)


def _touches(options: Options) -> Iterator[Touch]:
    meshes = options.shared["meshes"]
    if options.quick:
        yield Touch(options.objects[0], ticks=600, seed=options.seed)
        yield Touch(SLAP, ticks=400, seed=options.seed)
        yield Touch("golf-ball", ticks=600, noise_n=2e-3, seed=options.seed)
        return
    for name in (*options.objects, *OWN):
        yield Touch(name, meshes=meshes, seed=options.seed)
    yield Touch("golf-ball", noise_n=0.5e-3, seed=options.seed)
    yield Touch("golf-ball", noise_n=2e-3, seed=options.seed)


def means_of(rows: list[Row], touches: Collection[str], words: str) -> list[Row]:
    """Return a row for each scheme that was shown all of `touches`: its means over them.

    ``psnr_spread_db`` is the standard deviation of the touches' mean PSNR, ``receiver`` names all that were best.
    """
    of_schemes = grouped((row for row in rows if row["touch"] in touches), "scheme")
    return [
        {
            "touch": words,
            "scheme": scheme,
            "receiver": ", ".join(sorted({row["receiver"] for row in group})),
            "psnr_spread_db": round(pstdev(row["psnr_mean_db"] for row in group), 1),
        }
        | {key: None if any(row[key] is None for row in group) else mean(row[key] for row in group) for key in DIGITS}
        for (scheme,), group in of_schemes.items()
        if len(group) == len(touches)
    ]
