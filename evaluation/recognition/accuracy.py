"""One measurement: a classifier trained on a signal, and how often it is right on perturbations it never met."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from classifier.dagsvm import DagSvm
from classifier.validation import Chosen, choose_C, global_scale, part_of
from evaluation.observations import LABELS, OBJECTS, Split, draw_split, signal
from evaluation.result import Row
from reconstructor.checks import Values

#: C is chosen from these.
C_GRID: Final = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)
#: Longer signals are trained on their inner products, made once for all splits.
GRAM_FROM: Final = 1024
#: Iterations of a pair's solver at most. A few values cannot separate the objects, and a large C then runs on for
#: minutes without a better accuracy.
MOST_ITERATIONS: Final = 20_000
MOST_ITERATIONS_SHORT: Final = 3_000
SHORT: Final = 4


def measure_accuracy(
    *,
    kind: str,
    size: int,
    draw: int,
    splits: Sequence[int],
    development: float,
    validation: float,
    meshes: str | None,
    seed: int,
) -> Row:
    """Return the accuracy on the test set of each split, and the mean confusion matrix, for one draw of Φ.

    See `evaluation.observations.signal` and `evaluation.observations.draw_split`.
    """
    values = signal(kind, size, draw, meshes, seed)
    gram = np.asarray(values, np.float32) @ np.asarray(values, np.float32).T if size >= GRAM_FROM else None
    accuracies, confusion = [], np.zeros((OBJECTS, OBJECTS))
    for number in splits:
        split = draw_split(number, development, validation, seed)
        chosen, X = trained(values, split, gram)
        trained_on = split.training
        said = chosen.machine.predict(part_of(X, split.test, trained_on, chosen.machine))
        true = LABELS[split.test]
        np.add.at(confusion, (true, said), 1 / len(splits))
        accuracies.append(float(np.mean(said == true)))
    shares = confusion / confusion.sum(axis=1, keepdims=True)
    return {"accuracy": accuracies, "confusion": np.round(shares, 4).tolist()}


def trained(values: Values, split: Split, gram: npt.NDArray[np.float32] | None = None) -> tuple[Chosen, Values]:
    """Return the paper's classifier trained on a split, and what its rows are to be taken from.

    One global scale, so that the development set has a mean square of 1; C from the grid by the validation set.
    """
    iterations = MOST_ITERATIONS_SHORT if values.shape[1] <= SHORT else MOST_ITERATIONS
    scale = global_scale(values[split.development])
    if gram is None:
        X, machine = values * scale, DagSvm(max_iter=iterations)
    else:
        X, machine = gram * np.float32(scale**2), DagSvm(kernel="precomputed", max_iter=iterations)
    return choose_C(X, LABELS, split.development, split.validation, machine=machine, C_grid=C_GRID), X


def score(predict: Callable[[Any], Any], values: Values, split: Split) -> float:
    """Return how often `predict` is right on the test set of `values`."""
    return float(np.mean(predict(values[split.test]) == LABELS[split.test]))
