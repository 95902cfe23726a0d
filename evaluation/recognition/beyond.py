"""``skin evaluate recognition``: what goes beyond the paper's classifier, and the live service.

Chosen rows have the training perturbations of the paper's classifier beside them, one split for each draw of Φ. Live
rows use the default skin, our shapes and the model that the service trains, in every cycle with 2 mN or more; there
``runs`` counts touches.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from evaluation.recognition.accuracy import measure_chosen, measure_stepped
from evaluation.recognition.live import CONDITIONS, measure_live
from evaluation.result import Options, Result, Row, grouped
from evaluation.result_cache import measure_cells, measured_rows
from skin.sources import DEFAULT_OBJECTS
from touch.objects import CATALOGUE

SIZES: Final = (16, 4)
#: Objects of the catalogue the live model never met.
UNMET: Final = tuple(name for name in CATALOGUE if name not in DEFAULT_OBJECTS)
DRAWS: Final = 10


def evaluate(options: Options) -> Result:
    """Measure chosen rows against drawn rows, steps, and the live service."""
    return Result(
        "Recognition beyond the paper, and as a service",
        [*_chosen_rows(options), *_stepped_rows(options), *_live_rows(options)],
        note="Touches of live rows have our shapes of the objects, with meshes too; their runs count touches.",
    )


def _row(what: str, sums: int, *, runs: int, ours: Any, plain: Any = None, parts: Sequence[float] = ()) -> Row:
    """Return a row: mean accuracy of ours and of the plain classifier, percent; deviation and range over `parts`.

    `ours` and `plain` are numbers, or arrays with one for each run. Without `plain` or `parts` their columns are None.
    """
    return {
        "what": what,
        "sums": sums,
        "runs": runs,
        "ours": round(float(np.mean(ours)), 2),
        "plain": None if plain is None else round(float(np.mean(plain)), 2),
        "gain": None if plain is None else round(float(np.mean(ours - plain)), 2),
        "deviation": round(float(np.std(parts)), 2) if parts else None,
        "least": round(min(parts), 2) if parts else None,
        "most": round(max(parts), 2) if parts else None,
    }


def _chosen_rows(options: Options) -> list[Row]:
    """Return the rows of chosen rows of Φ beside drawn ones."""
    cells: list[Row] = [
        {"size": size, "draw": draw, "splits": [draw % 10], **options.shared}
        for size in (SIZES[:1] if options.quick else SIZES)
        for draw in range(options.draws_or(DRAWS))
    ]
    rows = []
    for (size,), group in grouped(measured_rows(measure_chosen, cells, options, "chosen rows"), "size").items():
        ours, plain = (100 * np.concatenate([each[key] for each in group]) for key in ("accuracy", "plain"))
        rows.append(_row("rows chosen", size, runs=len(ours), ours=ours, plain=plain, parts=ours.tolist()))
    return rows


def _stepped_rows(options: Options) -> list[Row]:
    """Return the row of steps: `DRAWS` splits, because Φ is the layout's."""
    cells: list[Row] = [{"splits": list(range(1 if options.quick else DRAWS)), **options.shared}]
    (result,) = measure_cells(measure_stepped, cells, options, "steps")
    percent = [100 * each for each in result["accuracy"]]
    return [_row("steps, coarse sums of blocks", result["sums"], runs=len(percent), ours=percent, parts=percent)]


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


def _live_row(what: str, group: list[Row], share: str) -> Row:
    """Return the mean share of a group of draws; `runs` counts touches."""
    percent = [100 * each[share] for each in group]
    parts = percent if len(percent) > 1 else ()
    return _row(what, group[0]["sums"], runs=sum(each["touches"] for each in group), ours=percent, parts=parts)
