"""``skin evaluate paper classification``: the paper's figures on recognising objects from sums, made again.

``runs`` counts draws of Φ x splits of each. 4096 sums have one draw: Φ then keeps all inner products up to a factor.
Splits of one draw differ by 0.4 %. The paper's "over 80 %", "approximately 70 %" and "under 60 %" are shown as 80, 70
and 60. It does not define its coarse taxels: means over cells of the fine array (``sensor``) come within 1 point of its
numbers in a quick run, spheres that fill a cell (``sensor, large taxels``) within 17.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np

from evaluation.observations import KINDS
from evaluation.printed import paper_value
from evaluation.recognition.accuracy import FULL, THREE_PERCENT, TRAINING, measure_accuracy
from evaluation.recognition.pictures import draw_accuracies, draw_confusions
from evaluation.result import Options, Picture, Result, Row, beside, grouped
from evaluation.result_cache import measured_rows
from touch.classification_poses import CLASSIFICATION_OBJECTS

NAMES: Final = {"sbhe": "SBHE", "noiselet": "noiselet", "averaged": "sensor", "large": "sensor, large taxels"}
SIZES: Final = (4096, 1024, 256, 64, 16, 4, 1)
#: Sums of the confusion matrices.
CONFUSION_SIZE: Final = 64
#: Confusions that the text names, (true, said); most without a number.
CONFUSIONS: Final = (
    ("volleyball", "basketball"),
    ("basketball", "volleyball"),
    ("gravy-can", "volleyball"),
    ("mustard-upright", "racquetball"),
    ("cereal-box", "cracker-box"),
    ("cereal-box", "mustard-lying"),
    ("jello-box", "basketball"),
)
DRAWS: Final = 10
#: Draws of 16 sums: their accuracies differ by several percent from draw to draw.
DRAWS_OF_FEW: Final = 40
_FEW: Final = 16
SPLITS: Final = 10
#: Sizes the paper gives numbers for: measured with every split, and all that a quick look measures.
_COMPARED_SIZES: Final = (64, 16)


def evaluate(options: Options) -> Result:
    """Measure accuracies over signal size and training size, and the confusion matrices."""
    measured = measured_rows(measure_accuracy, _cells(options), options, "classification")
    sizes = _rows([one for one in measured if one["development"] == FULL[0]], "signal size")
    training = _rows([one for one in measured if (one["kind"], one["size"]) in _CURVES], "training size")
    confusions = {
        kind: _confusion([one for one in measured if _is(one, kind, CONFUSION_SIZE, THREE_PERCENT)])
        for kind in ("sbhe", "noiselet")
    }
    pictures = [
        Picture(
            f"Accuracy over signal size, {_percent(FULL):g} % training. {_MARKS}",
            lambda: draw_accuracies(sizes, "size", "signal size (values per observation)", lambda row: row["signal"]),
        ),
        Picture(
            f"Accuracy over training size, development and validation set together. {_MARKS}",
            lambda: draw_accuracies(
                training,
                "training_percent",
                "training size (% of the perturbations)",
                lambda row: f"{row['signal']}, {row['size']}",
            ),
        ),
        Picture(
            f"Confusion, percent of the true object (row) called the column, {CONFUSION_SIZE} sums, "
            f"{_percent(THREE_PERCENT):g} % training.",
            lambda: draw_confusions(confusions, CLASSIFICATION_OBJECTS),
        ),
    ]
    accuracies = [*sizes, *(row for row in training if row["training_percent"] != _percent(FULL))]
    title = "Objects from sums: signal size, training size, confusions"
    return Result(title, [*accuracies, *_confused(confusions)], pictures)


_MARKS: Final = "Bars span the draws of Φ, crosses are the paper's numbers, the dotted line is guessing."
#: Signals of the training-size figure.
_CURVES: Final = (("sbhe", 16), ("noiselet", 16), ("averaged", 4096), ("averaged", 16))


def _cells(options: Options) -> list[Row]:
    """Return one cell for each draw of Φ, signal and training size."""
    wanted = [(kind, size, FULL) for kind in KINDS for size in SIZES if kind != "large" or size < SIZES[0]]
    wanted += [(kind, size, shares) for kind, size in _CURVES for shares in TRAINING[1:]]
    wanted += [(kind, CONFUSION_SIZE, THREE_PERCENT) for kind in ("sbhe", "noiselet")]
    if options.quick:
        wanted = [one for one in wanted if one[1] in _COMPARED_SIZES and one[2] in {FULL, THREE_PERCENT}]
    return [cell for kind, size, shares in wanted for cell in _cells_of(kind, size, shares, options)]


def _cells_of(kind: str, size: int, shares: tuple[float, float], options: Options) -> list[Row]:
    """Return one cell for each draw of Φ of a signal and training size."""
    development, validation = shares
    draws = _draws(kind, size, options.draws_or(DRAWS), is_few=_is_few(kind, size, development, options))
    return [
        {"kind": kind, "size": size, "draw": draw, "splits": _splits(kind, size, draw, development, options)}
        | {"development": development, "validation": validation, **options.shared}
        for draw in range(draws)
    ]


def _is_few(kind: str, size: int, development: float, options: Options) -> bool:
    """Tell whether `DRAWS_OF_FEW` draws of a signal are measured: of 16 sums, with the full training set."""
    is_drawn = kind in {"sbhe", "noiselet"}
    return is_drawn and size == _FEW and development == FULL[0] and options.draws is None and not options.quick


def _draws(kind: str, size: int, draws: int, *, is_few: bool) -> int:
    """Return the draws of a signal: one where nothing is drawn, or every draw is the same signal turned."""
    if kind not in {"sbhe", "noiselet"} or size == 4096:
        return 1
    if is_few:
        return DRAWS_OF_FEW
    return min(draws, 3) if size == 1024 else draws


def _splits(kind: str, size: int, draw: int, development: float, options: Options) -> list[int]:
    """Return the splits for one draw: all of them where the figures are compared, else some that differ by draw."""
    if options.quick:
        return [0]
    if size == 4096:
        return list(range(3 if development >= TRAINING[1][0] else SPLITS))
    if _is_few(kind, size, development, options):
        return [draw % SPLITS, (draw + 1) % SPLITS]
    if size in _COMPARED_SIZES and development in {FULL[0], THREE_PERCENT[0]}:
        return list(range(SPLITS))
    count = 4 if size == 16 else 2
    return [(count * draw + offset) % SPLITS for offset in range(count)]


def _is(one: Row, kind: str, size: int, shares: tuple[float, float]) -> bool:
    return (one["kind"], one["size"], one["development"]) == (kind, size, shares[0])


def _printed_accuracy(kind: str, size: int, shares: Iterable[float]) -> float | None:
    """Return the accuracy that the paper's text gives a signal, percent, None where only its curves have it."""
    return paper_value("classification", signal=NAMES[kind], size=size, training_percent=_percent(shares))


def _percent(shares: Iterable[float]) -> float:
    return round(100 * sum(shares), 2)


def _rows(measured: list[Row], figure: str) -> list[Row]:
    """Return one row for each signal, size and training size, in order of appearance: means over draws and splits."""
    rows = []
    for (kind, size, *shares), group in grouped(measured, "kind", "size", "development", "validation").items():
        by_draw = [100 * float(np.mean(one["accuracy"])) for one in group]
        every = [100 * accuracy for one in group for accuracy in one["accuracy"]]
        rows.append(
            {
                "figure": figure,
                "signal": NAMES[kind],
                "size": size,
                "training_percent": _percent(shares),
                "draws": len(group),
                "runs": len(every),
                **beside(float(np.mean(every)), _printed_accuracy(kind, size, shares)),
                "least_draw": round(min(by_draw), 2),
                "most_draw": round(max(by_draw), 2),
                "sd_runs": round(float(np.std(every)), 2),
            }
        )
    return rows


def _confusion(measured: list[Row]) -> list[list[float]]:
    return (100 * np.mean([one["confusion"] for one in measured], axis=0)).tolist()  # type: ignore[no-any-return]


def _confused(confusions: dict[str, list[list[float]]]) -> list[Row]:
    """Return a row for every confusion the paper names."""
    rows = []
    for kind, matrix in confusions.items():
        for true, said in CONFUSIONS:
            share = matrix[CLASSIFICATION_OBJECTS.index(true)][CLASSIFICATION_OBJECTS.index(said)]
            rows.append(
                {
                    "figure": f"{true} called {said}",
                    "signal": NAMES[kind],
                    "size": CONFUSION_SIZE,
                    "training_percent": _percent(THREE_PERCENT),
                    **dict.fromkeys(("draws", "runs")),
                    **beside(share, paper_value("classification", figure=f"{true} called {said}", signal=NAMES[kind])),
                    **dict.fromkeys(("least_draw", "most_draw", "sd_runs")),
                }
            )
    return rows
