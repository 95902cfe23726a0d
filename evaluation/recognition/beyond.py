"""``skin evaluate recognition``: what goes beyond the paper's classifier, and the live service."""

from typing import Any, Final

import numpy as np

from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Picture, Row
from evaluation.recognition.live import CONDITIONS, measure_live
from evaluation.recognition.methods import CYCLES, METHODS, PLAIN, measure_method
from evaluation.recognition.pictures import draw_gains
from skin.sources import DEFAULT_OBJECTS
from touch.objects import CATALOGUE

SIZES: Final = (64, 16, 4)
#: Objects of the catalogue the live model never met.
UNMET: Final = tuple(name for name in CATALOGUE if name not in DEFAULT_OBJECTS)
DRAWS: Final = 10
#: Methods measured with 4 sums as well: where few sums are the point.
_FOR_FEW: Final = (PLAIN, "rows chosen", f"rows chosen, mean of {CYCLES} cycles")
#: Methods not measured with 64 sums, where they take long and there is little to gain.
_NOT_FOR_MANY: Final = tuple(name for name in METHODS if name.startswith(("rows chosen", "products")))
_QUICK: Final = (PLAIN, "rows chosen", "10 % missing: as 0, rehearsed", "10 % missing: estimated")


def evaluate(options: Options) -> Findings:
    """Measure every method against the plain DAGSVM, then the live service."""
    methods = _method_rows(options)
    rows = [*methods, *_live_rows(options)]
    pictures = [Picture("methods", _CAPTION, lambda: draw_gains(methods))]
    return Findings("Recognition beyond the paper, and as a service", rows, list(_NOTES), pictures)


def _method_rows(options: Options) -> list[Row]:
    draws = options.draws or (1 if options.quick else DRAWS)
    cells = [
        {
            "method": method,
            "size": size,
            "draw": draw,
            "splits": [draw % 10],
            "meshes": str(options.meshes) if options.meshes else None,
            "seed": options.seed,
        }
        for size in ((16,) if options.quick else SIZES)
        for method in (_QUICK if options.quick else METHODS)
        if (size > min(SIZES) or method in _FOR_FEW) and (size < max(SIZES) or method not in _NOT_FOR_MANY)
        for draw in range(draws)
    ]
    results = measure_cells(measure_method, cells, options, "recognition")
    groups: dict[tuple[Any, ...], list[tuple[float, float]]] = {}
    for cell, result in zip(cells, results, strict=True):
        pairs = zip(result["accuracy"], result["plain"], strict=True)
        groups.setdefault((cell["method"], cell["size"]), []).extend(pairs)
    return [_row(method, size, 100 * np.array(pairs)) for (method, size), pairs in groups.items()]


def _row(what: str, size: int, percents: Any) -> Row:
    ours, plain = percents.T
    return {
        "what": what,
        "sums": size,
        "runs": len(ours),
        "ours": round(float(ours.mean()), 2),
        "plain": round(float(plain.mean()), 2),
        "gain": round(float((ours - plain).mean()), 2),
        "least": round(float(ours.min()), 2),
        "most": round(float(ours.max()), 2),
    }


def _live_rows(options: Options) -> list[Row]:
    conditions = CONDITIONS[:1] if options.quick else CONDITIONS
    known: list[Row] = [
        {"names": list(DEFAULT_OBJECTS), "touches": 5, "lost_ratio": lost, "noise_ratio": noise, "seed": options.seed}
        for lost, noise in conditions
    ]
    unmet: list[Row] = [
        {
            "names": [name],
            "touches": 1 if options.quick else 3,
            "lost_ratio": 0.0,
            "noise_ratio": 1.0,
            "seed": options.seed,
        }
        for name in (UNMET[:1] if options.quick else UNMET)
    ]
    results = measure_cells(measure_live, known + unmet, options, "live")
    rows = []
    for cell, result in zip(known, results, strict=False):
        named = (
            f"live, known objects, {cell['lost_ratio']:.0%} of the blocks dead, {cell['noise_ratio']:g} of the noise"
        )
        rows += [
            _live_row(f"{named}: right", result["right"]),
            _live_row(f"{named}: called unknown", result["unknown"]),
        ]
    for cell, result in zip(unmet, results[len(known) :], strict=True):
        rows.append(_live_row(f"live, {cell['names'][0]}, never met: called unknown", result["unknown"]))
    return rows


def _live_row(what: str, share: float) -> Row:
    return {
        "what": what,
        "sums": 1024,
        "runs": 1,
        "ours": round(100 * share, 2),
        "plain": None,
        "gain": None,
        "least": None,
        "most": None,
    }


_NOTES: Final = (
    (
        "Percent. Every method is given the sums and the training perturbations of the plain DAGSVM it stands "
        "beside, one split for each draw of Φ; test perturbations take part in no choice."
    ),
    (
        "Rows chosen: of all 4096 rows of the same scrambled blocks, the 16 or 4 that tell the training "
        "observations apart best; choosing them needs one recording of the training touches with every row."
    ),
    (
        f"Mean of {CYCLES} cycles: trained on single cycles; only what is asked about is a mean over cycles of one "
        "touch."
    ),
    (
        "10 % of the blocks missing: other blocks in every observation. Rehearsed: trained on the whole sums and on "
        "the same with such losses. The service estimates missing raw sums, which loses least."
    ),
    (
        "Live: the default skin and the model the service trains by itself, every cycle in which an object touches "
        "with 2 mN or more. A volleyball is not told from the basketball the model knows: their contacts hardly "
        "differ."
    ),
)
_CAPTION: Final = (
    "Accuracy of each method beside the plain DAGSVM on the same sums and training data; whiskers span the draws of "
    "Φ. Choosing which rows to send gains most: 16 chosen sums beat 64 drawn ones."
)
