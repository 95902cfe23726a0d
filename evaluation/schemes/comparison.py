"""``skin evaluate rivals``: our sums, at a fixed rate and adaptive, against scans, coarse arrays and events."""

from collections.abc import Collection, Iterable, Iterator
from operator import itemgetter
from statistics import mean
from typing import Final

from evaluation.result import Options, Result, Row, grouped
from evaluation.result_cache import measure_cells, measured_rows
from evaluation.schemes.scenes import OWN, SIDE, SLAP, Touch
from evaluation.schemes.schemes import Adaptive, FilteredEvents, Scan, Scheme, Sums, measure_scheme
from skin.sources import object_label

OURS: Final = Adaptive()
#: Thresholds in newtons that filtered taxels are tried with.
THRESHOLDS_N: Final = (0.2e-3, 0.3e-3, 0.5e-3, 0.8e-3, 1.2e-3)
SCHEMES: Final[tuple[Scheme, ...]] = (
    OURS,
    Adaptive(is_fd=True),
    Sums(),
    Scan(SIDE),
    Scan(SIDE, "solved"),
    Scan(32, "solved"),
    Scan(16),
    *map(FilteredEvents, THRESHOLDS_N),
)
_QUICK: Final[tuple[Scheme, ...]] = (OURS, Sums(), Scan(SIDE), Scan(32, "solved"), FilteredEvents(0.5e-3))
#: Those that scenes drawn at random are shown; plain scans are 9 dB behind in all of them.
_DRAWN: Final[tuple[Scheme, ...]] = (OURS, Sums(), Scan(SIDE, "solved"), *map(FilteredEvents, THRESHOLDS_N))
#: Bits of schemes with a rate that differ by less are equal: scans have whole frames.
EQUAL_BITS: Final = 0.05
#: Less is not told apart.
LEVEL_DB: Final = 0.5
#: Columns of the table, and places after the point.
DIGITS: Final = {
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
        `quick` looks at three touches, cut short.
    """
    found = measured(_touches(options), options, "rivals")
    slides = set(map(object_label, options.objects))
    together = means_of(found, slides, f"{len(slides)} slides") if len(slides) > 1 else []
    return compared("Schemes", together + found)


def measured(touches: Iterable[Touch], options: Options, what: str) -> list[Row]:
    """Return the figures of every scheme on every touch, a row each."""
    schemes = _QUICK if options.quick else SCHEMES
    cells: list[Row] = [{"scheme": scheme, "touch": touch} for touch in touches for scheme in schemes]
    return [
        {"touch": row["touch"].words, "scheme": row["scheme"].name} | {key: row[key] for key in DIGITS}
        for row in measured_rows(measure_scheme, cells, options, what)
    ]


def compared(title: str, found: list[Row], note: str = "") -> Result:
    """Return the result of rows that were measured: rounded, and with a verdict for each touch."""
    return Result(
        f"{title} on the same four classic buses; those with a rate at the bits a second of the default skin",
        [row | {key: None if row[key] is None else round(row[key], DIGITS[key]) for key in DIGITS} for row in found],
        note=note + wins_and_losses(found),
    )


def evaluate_drawn(options: Options) -> Result:
    """Measure adaptive sums and their rivals on scenes drawn at random, `scenes` of `scene_seed`.

    Each scene has two rivals: of all schemes that with the best PSNR, so that the threshold of events is tuned to the
    scene, and the one scheme with the best mean PSNR over all scenes.
    """
    count, ticks = (2, 400) if options.quick else (options.scenes, None)
    if count == 0:  # of all subjects together
        return Result("No drawn scenes were asked for", [])
    touches = [
        Touch(str(number), ticks=ticks, scene_seed=options.scene_seed, **options.shared) for number in range(count)
    ]
    schemes = _QUICK if options.quick else _DRAWN
    cells: list[Row] = [{"scheme": scheme, "touch": touch} for touch in touches for scheme in schemes]
    found = iter(measure_cells(measure_scheme, cells, options, "drawn scenes"))
    scenes = [[next(found) for _ in schemes] for _ in touches]
    fixed = max(range(1, len(schemes)), key=lambda each: mean(float(scene[each]["psnr_mean_db"]) for scene in scenes))
    rows = []
    for touch, scene in zip(touches, scenes, strict=True):
        ours, *rivals = scene
        psnrs_db = [float(each["psnr_mean_db"]) for each in rivals]
        tuned = psnrs_db.index(max(psnrs_db))
        nearest = min(rivals, key=itemgetter("touched_error_mn"))
        rows.append(
            {"scene": touch.words, "psnr_db": round(ours["psnr_mean_db"], 1), "best_rival": schemes[1 + tuned].name}
            | _against(ours, rivals[tuned], nearest, "")
            | _against(ours, scene[fixed], scene[fixed], "fixed_")
        )
    title = f"Adaptive sums on {count} drawn scenes of seed {options.scene_seed}, each against its best rival"
    note = [f"{schemes[fixed].name} is the best fixed rival."]
    note += [_counts(rows, rival, prefix) for rival, prefix in (("the best of each scene", ""), ("it", "fixed_"))]
    return Result(title, rows, note="\n".join(note))


def _against(ours: Row, rival: Row, nearest: Row, prefix: str) -> Row:
    """Return gains over a rival, above 0 or below 1 where ours is better; `nearest` has the least error of touches."""
    return {
        f"{prefix}gain_db": round(ours["psnr_mean_db"] - rival["psnr_mean_db"], 2),
        f"{prefix}error_ratio": round(ours["touched_error_mn"] / nearest["touched_error_mn"], 3),
        f"{prefix}bits_ratio": round(ours["kbit_per_s"] / rival["kbit_per_s"], 3),
    }


def _counts(rows: list[Row], rival: str, prefix: str) -> str:
    """Return in how many scenes adaptive sums are as good as a rival, and the scenes where they are not."""
    said = []
    for what, is_missed in (
        (f"PSNR at most {LEVEL_DB} dB below", [row[f"{prefix}gain_db"] < -LEVEL_DB for row in rows]),
        ("touched error smaller", [row[f"{prefix}error_ratio"] >= 1 for row in rows]),
        ("fewer bits", [row[f"{prefix}bits_ratio"] >= 1 for row in rows]),
    ):
        missed = [str(row["scene"]) for row, wrong in zip(rows, is_missed, strict=True) if wrong]
        said.append(f"{what} in {len(rows) - len(missed)}" + (f" (not: {'; '.join(missed)})" if missed else ""))
    return f"Against {rival}, of {len(rows)} scenes: {', '.join(said)}."


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
    yield Touch("golf ball at rest", loss_ratio=0.01, seed=options.seed)


def means_of(rows: list[Row], touches: Collection[str], words: str) -> list[Row]:
    """Return a row for each scheme that was shown all of `touches`: its means over them."""
    of_schemes = grouped((row for row in rows if row["touch"] in touches), "scheme")
    return [
        {"touch": words, "scheme": scheme}
        | {key: None if any(row[key] is None for row in group) else mean(row[key] for row in group) for key in DIGITS}
        for (scheme,), group in of_schemes.items()
        if len(group) == len(touches)
    ]


def wins_and_losses(shown: list[Row]) -> str:
    """Return two lines for each touch: our schemes against the rivals with the best PSNR and with the least error.

    A line that begins with ``LOSS`` names where our scheme is worse. The rivals of sums at a fixed rate have a rate,
    too, and the same bits.
    """
    lines = []
    for ours, title in (
        (OURS.name, "Adaptive sums against the best other scheme of each touch:"),
        (Sums().name, "Sums at a fixed rate against the best scan or coarse array of each touch, at equal bits:"),
    ):
        lines += [title]
        for (touch,), rows in grouped(shown, "touch").items():
            mine = next((row for row in rows if row["scheme"] == ours), None)
            others = [row for row in rows if not row["scheme"].startswith(ours)]
            rivals = [row for row in others if ours == OURS.name or row["rate_hz"] is not None]
            lines += [_verdict(touch, mine, rivals)] if mine and rivals else []
    return "\n".join(lines)


def _verdict(touch: str, ours: Row, others: list[Row]) -> str:
    """Return a line that begins with ``win``, or with ``LOSS`` and where ours is worse."""
    best = max(others, key=itemgetter("psnr_mean_db"))
    gain_db = ours["psnr_mean_db"] - best["psnr_mean_db"]
    worse = [] if gain_db > 0 else ["PSNR"]
    said = f"{gain_db:+.1f} dB to {best['scheme']}"
    if ours["touched_error_mn"] is not None:
        nearest = min(others, key=itemgetter("touched_error_mn"))
        worse += [] if ours["touched_error_mn"] < nearest["touched_error_mn"] else ["touched error"]
        said += f"; touched {ours['touched_error_mn']:.2f} mN, "
        said += f"{nearest['touched_error_mn']:.2f} {nearest['scheme']}"
    more = 0.0 if ours["rate_hz"] is None else EQUAL_BITS
    worse += [] if ours["kbit_per_s"] < best["kbit_per_s"] * (1 + more) else ["bits"]
    said += f"; {ours['kbit_per_s']:.0f} kbit/s, {best['kbit_per_s']:.0f} {best['scheme']}"
    return f"{'LOSS in ' + ', '.join(worse) if worse else 'win'}: {touch}: {said}"
