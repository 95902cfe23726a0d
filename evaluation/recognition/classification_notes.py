"""Notes and captions of ``skin evaluate classification``, from the rows that were measured."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from evaluation.findings import Options, Row
from evaluation.observations.signals import OBJECTS, TAXELS
from evaluation.recognition.accuracy import MOST_ITERATIONS, MOST_ITERATIONS_SHORT, SHORT
from touch.perturbations import CLASSIFICATION_OBJECTS, PERTURBATIONS

NAMES: Final = {"sbhe": "SBHE", "noiselet": "noiselet", "averaged": "sensor", "large": "sensor, large taxels"}
_FEW: Final = 16


def notes(rows: Sequence[Row], options: Options) -> list[str]:
    """Return what a reader must know to judge the accuracies in `rows`."""
    objects = "meshes" if options.meshes else "the shapes that ship; with --meshes the paper's own"
    sizes = {row["size"] for row in rows}
    told = [
        (
            f"{OBJECTS} objects x {PERTURBATIONS} perturbations, 9.99 mm deep, noise 1 mN, then clipped; objects: "
            f"{objects}."
        ),
        (
            "Accuracy in percent on test perturbations that neither training nor the choice of C saw; one global "
            "scale; C from 0.01 to 1000 by the validation set, then trained on both sets."
        ),
        _means(rows),
        _iterations(sizes),
        _coarse(rows),
        "The can sizes are not published; ours are common sizes.",
        (
            "Training percent is development plus validation; the paper lists one validation ratio too few, half of "
            "each development ratio is taken. Its 'over 80 %', 'approximately 70 %' and 'under 60 %' are shown as "
            "80, 70 and 60."
        ),
    ]
    if options.quick:
        shown = ", ".join(str(size) for size in sorted(sizes))
        told.append(f"A quick look: one split of each draw, signals of {shown} values alone; it judges no figure.")
    return told


def _means(rows: Sequence[Row]) -> str:
    told = (
        "Means over draws of Φ and over splits; 'draws' and 'runs' tell over how many, runs being draws times splits "
        "a draw. The paper gives means over 10 splits of what reads as one draw"
    )
    spans = [row["most_draw"] - row["least_draw"] for row in rows if row["size"] == _FEW and row["draws"] > 1]
    told += f"; at {_FEW} sums draws differ by up to {max(spans):.1f} points." if spans else "."
    if any(row["size"] == TAXELS for row in rows):
        told += (
            f" {TAXELS} sums: one draw, since Φ then turns the signal without changing an inner product, which gives "
            "the sensor's own result."
        )
    return told


def _iterations(sizes: set[int]) -> str:
    fewer = f", at {MOST_ITERATIONS_SHORT:,} for signals of {SHORT} values or fewer" if min(sizes) <= SHORT else ""
    return f"Solver capped at {MOST_ITERATIONS:,} iterations a pair{fewer}."


def _coarse(rows: Sequence[Row]) -> str:
    """Tell how far both kinds of coarse taxels are from the paper's numbers."""
    printed: dict[tuple[int, float], float] = {
        (row["size"], row["training_percent"]): row["paper"]
        for row in rows
        if row["signal"] == NAMES["averaged"] and row["paper"] is not None
    }

    def farthest(kind: str) -> float:
        places = ((row, (row["size"], row["training_percent"])) for row in rows if row["signal"] == NAMES[kind])
        return max(abs(float(row["ours"]) - printed[place]) for row, place in places if place in printed)

    return (
        "The paper does not say what its coarse taxels are. Means over cells of the fine array "
        f"('{NAMES['averaged']}') come within {farthest('averaged'):.1f} points of its numbers, spheres that fill a "
        f"cell ('{NAMES['large']}') within {farthest('large'):.1f}."
    )


def size_caption(sizes: Sequence[Row]) -> str:
    """Return the caption of accuracy over signal size."""
    few = {row["signal"]: row["ours"] for row in sizes if row["size"] == _FEW}
    compared = ", ".join(f"{name} {percent:.1f} %" for name, percent in few.items())
    return (
        f"Accuracy over signal size, {sizes[0]['training_percent']:g} % training. Bars span the draws of Φ; crosses "
        f"are the paper's numbers; the dotted line is guessing. With {_FEW} values: {compared}."
    )


def training_caption(training: Sequence[Row]) -> str:
    """Return the caption of accuracy over training size: from where on few sums beat as many fully trained taxels."""
    sums, taxels = (
        {
            row["training_percent"]: row["ours"]
            for row in training
            if (row["signal"], row["size"]) == (NAMES[kind], _FEW)
        }
        for kind in ("sbhe", "averaged")
    )
    most = max(taxels)
    above = [percent for percent, accuracy in sums.items() if accuracy > taxels[most]]
    least = (
        f"the least training with which {_FEW} SBHE sums are above that is {min(above):g} %"
        if above
        else (f"{_FEW} SBHE sums are never above that")
    )
    return (
        "Accuracy over training size, development and validation set together. The "
        f"{_FEW} taxels of a coarse array reach {taxels[most]:.1f} % with {most:g} % training; {least}."
    )


def confusion_caption(confusions: Mapping[str, Sequence[Sequence[float]]], size: int, percent: float) -> str:
    """Return the caption of the confusion matrices (percent), with the commonest confusion of each."""
    commonest = []
    for kind, matrix in confusions.items():
        wrong = np.array(matrix)
        np.fill_diagonal(wrong, 0)
        true, said = np.unravel_index(int(wrong.argmax()), wrong.shape)
        named = f"{CLASSIFICATION_OBJECTS[true]} called {CLASSIFICATION_OBJECTS[said]}"
        commonest.append(f"{NAMES[kind]} {named} ({wrong.max():.0f} %)")
    return (
        f"Confusion, percent of the true object (row) called the column, {size} sums, {percent:g} % training. The "
        f"commonest: {'; '.join(commonest)}."
    )
