"""``skin evaluate recognition``: what goes beyond the paper's classifier, and the live service.

Every method uses the sums and the training perturbations of the plain DAGSVM beside it, one split for each draw of Φ.
Live rows use the default skin, our shapes and the model that the service trains, in every cycle with 2 mN or more;
there ``runs`` counts touches.
"""

from typing import Final

import numpy as np

from classifier.cache import TOUCHES_PER_OBJECT
from evaluation.recognition.accuracy import measure_stepped
from evaluation.recognition.live import CONDITIONS, measure_live
from evaluation.recognition.methods import CYCLES, METHODS, PLAIN, measure_method
from evaluation.recognition.pictures import draw_gains, gain_row
from evaluation.recognition.sixteen import measure_sixteen
from evaluation.result import Options, Picture, Result, Row, grouped
from evaluation.result_cache import measure_cells, measured_rows
from skin.sources import DEFAULT_OBJECTS, OBJECT_GROUPS, StrokeKind
from touch.objects import CATALOGUE

SIZES: Final = (64, 16, 4)
#: Objects of the catalogue the live model never met.
UNMET: Final = tuple(name for name in CATALOGUE if name not in DEFAULT_OBJECTS)
DRAWS: Final = 10
#: The sixteen live: kind of touch, sums, samples of a taxel in a cycle (the paper has one), draws of Φ.
SIXTEEN: Final[tuple[tuple[StrokeKind, int, int, int], ...]] = (
    ("slide", 1024, 10, 1),
    ("press", 64, 10, DRAWS),
    ("press", 16, 10, DRAWS),
    ("press", 64, 1, DRAWS),
    ("press", 16, 1, DRAWS),
)
#: Touches of each of the sixteen.
SIXTEEN_TOUCHES: Final = 3
#: Methods measured with 4 sums as well: where few sums are the point.
_FOR_FEW: Final = (PLAIN, "rows chosen", f"rows chosen, mean of {CYCLES} cycles")
#: Methods not measured with 64 sums, where they take long and there is little to gain.
_NOT_FOR_MANY: Final = tuple(name for name in METHODS if name.startswith("rows chosen"))
_QUICK: Final = (PLAIN, "rows chosen", "10 % missing: as 0", "10 % missing: estimated")


def evaluate(options: Options) -> Result:
    """Measure every method against the plain DAGSVM, then the live service."""
    methods = _method_rows(options)
    pictures = [Picture(_CAPTION, lambda: draw_gains(methods))]
    return Result(
        "Recognition beyond the paper, and as a service",
        [*methods, *_stepped_rows(options), *_live_rows(options), *_sixteen_rows(options)],
        pictures,
        "Touches of live rows have our shapes of the objects, with meshes too; their runs count touches.",
    )


_CAPTION: Final = (
    "Accuracy of each method beside the plain DAGSVM (dotted) on the same sums and training data; whiskers span the "
    "draws of Φ."
)


def _method_rows(options: Options) -> list[Row]:
    draws = options.draws_or(DRAWS)
    cells: list[Row] = [
        {"method": method, "size": size, "draw": draw, "splits": [draw % 10], **options.shared}
        for size in ((16,) if options.quick else SIZES)
        for method in (_QUICK if options.quick else METHODS)
        if (size > min(SIZES) or method in _FOR_FEW) and (size < max(SIZES) or method not in _NOT_FOR_MANY)
        for draw in range(draws)
    ]
    measured = measured_rows(measure_method, cells, options, "recognition")
    rows = []
    for (method, size), group in grouped(measured, "method", "size").items():
        ours, plain = (100 * np.concatenate([each[key] for each in group]) for key in ("accuracy", "plain"))
        rows.append(gain_row(method, size, runs=len(ours), ours=ours, plain=plain, parts=ours.tolist()))
    return rows


def _stepped_rows(options: Options) -> list[Row]:
    """Return the row of steps: `DRAWS` splits, because Φ is the layout's."""
    cells: list[Row] = [{"splits": list(range(1 if options.quick else DRAWS)), **options.shared}]
    (result,) = measure_cells(measure_stepped, cells, options, "steps")
    percent = [100 * each for each in result["accuracy"]]
    return [gain_row("steps, coarse sums of blocks", result["sums"], runs=len(percent), ours=percent, parts=percent)]


def _live_rows(options: Options) -> list[Row]:
    """Return the rows of the live service: of objects it knows, and of objects the model never met."""
    conditions = CONDITIONS[:1] if options.quick else CONDITIONS
    touches = 1 if options.quick else 3
    # A draw has touches, training and noise of its own; the conditions of a draw share its model.
    known: list[Row] = [
        {"names": list(DEFAULT_OBJECTS), "touches": 5, "lost_ratio": lost, "noise_ratio": noise}
        | {"seed": options.seed + draw}
        for draw in range(options.draws_or(DRAWS))
        for lost, noise in conditions
    ]
    unmet: list[Row] = [
        {"names": [name], "touches": touches, "lost_ratio": 0.0, "noise_ratio": 1.0, "seed": options.seed}
        for name in (UNMET[:1] if options.quick else UNMET)
    ]
    measured = measured_rows(measure_live, known + unmet, options, "live")
    rows = []
    for (lost, noise), group in grouped(measured[: len(known)], "lost_ratio", "noise_ratio").items():
        named = f"live, known objects, {lost:.0%} of the blocks dead, {noise:g} of the noise"
        rows += [
            _live_row(f"{named}: right", group, "right"),
            _live_row(f"{named}: called unknown", group, "unknown"),
        ]
    return rows + [
        _live_row(f"live, {each['names'][0]}, never met: called unknown", [each], "unknown")
        for each in measured[len(known) :]
    ]


def _sixteen_rows(options: Options) -> list[Row]:
    """Return the rows of the paper's sixteen objects live; a draw of Φ has touches, training and noise of its own."""
    cells: list[Row] = [
        {"stroke": stroke, "sums": sums, "samples": samples, "draw": draw, "seed": options.seed + draw}
        for stroke, sums, samples, draws in (SIXTEEN[-2:-1] if options.quick else SIXTEEN)
        for draw in range(1 if options.quick else draws)
    ]
    extent: Row = {
        "touches": len(OBJECT_GROUPS["paper"]) * (1 if options.quick else SIXTEEN_TOUCHES),
        "per_object": TOUCHES_PER_OBJECT // (6 if options.quick else 1),
    }
    measured = measured_rows(measure_sixteen, [cell | extent for cell in cells], options, "sixteen live")
    rows = []
    for (stroke, sums, samples), group in grouped(measured, "stroke", "sums", "samples").items():
        named = f"live, our shapes of the paper's 16, {stroke}, samples a cycle {samples}"
        for share, what in _SHARES.items():
            percent = [100 * each[share] for each in group]
            runs = extent["touches"] * len(group)
            rows.append(gain_row(f"{named}: {what}", sums, runs=runs, ours=percent, parts=percent))
    return rows


_SHARES: Final = {
    "held": "right, pressed in fully",
    "right": "right, all cycles",
    "unknown": "called unknown",
    "empty": "called no contact",
}


def _live_row(what: str, group: list[Row], share: str) -> Row:
    """Return the mean share of a group of draws; `runs` counts touches."""
    percent = [100 * each[share] for each in group]
    parts = percent if len(percent) > 1 else ()
    return gain_row(what, group[0]["sums"], runs=sum(each["touches"] for each in group), ours=percent, parts=parts)
