"""One measurement: a classifier trained on a signal, and how often it is right on perturbations it never met."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from classifier.dagsvm import DagSvm
from classifier.rows import choose_rows
from classifier.samples import simulate_sums
from classifier.used_sums import classified_phi
from classifier.validation import Chosen, choose_C, global_scale, part_of
from evaluation.observations import (
    LABELS,
    OBJECTS,
    Indices,
    Split,
    all_rows,
    draw_split,
    drawn_sbhe,
    measured,
    sensed,
    signal,
    true_force_n,
)
from evaluation.result import Row
from reconstructor.checks import Values
from skin.layout import load_layout
from skin.taxel import NOISE_N

#: Development and validation set as parts of the perturbations. The paper lists five validation ratios for its six
#: development ratios; its text fits half of each development ratio.
TRAINING: Final = ((0.4, 0.2), (0.2, 0.1), (0.1, 0.05), (0.06, 0.03), (0.02, 0.01), (0.0066, 0.0033))
FULL, THREE_PERCENT = TRAINING[0], TRAINING[4]
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
    accuracies, confusion = [], np.zeros((OBJECTS, OBJECTS))
    for said, true in decisions(values, [draw_split(number, development, validation, seed) for number in splits]):
        np.add.at(confusion, (true, said), 1 / len(splits))
        accuracies.append(float(np.mean(said == true)))
    shares = confusion / confusion.sum(axis=1, keepdims=True)
    return {"accuracy": accuracies, "confusion": np.round(shares, 4).tolist()}


def measure_chosen(*, size: int, draw: int, splits: Sequence[int], meshes: str | None, seed: int) -> Row:
    """Return the ``accuracy`` of sums whose rows of Φ are chosen, and of drawn sums as ``plain``, for each split.

    As many rows of the same scrambled blocks are chosen on the training perturbations.
    """
    felt, drawn, every = sensed(meshes, seed), drawn_sbhe(size, draw), all_rows(draw)
    found: Row = {"accuracy": [], "plain": []}
    for number in splits:
        split = draw_split(number, *FULL, seed)
        rows = split.training
        chosen = choose_rows(every, every.forward(felt[rows]), LABELS[rows], size)
        for name, phi in (("accuracy", chosen), ("plain", drawn)):
            ((said, true),) = decisions(measured(phi, felt), [split])
            found[name].append(float(np.mean(said == true)))
    return found


def measure_stepped(*, splits: Sequence[int], meshes: str | None, seed: int) -> Row:
    """Return the accuracy of the paper's classifier on the test set of each split, and the number of ``sums``.

    The sums are those that the classifier takes of the shipped layout ``steps``, with what the nodes leave of the
    noise, see `classifier.samples.simulate_sums`.
    """
    layout = load_layout(Path("steps"))
    rng = np.random.default_rng(seed)
    sums = simulate_sums(true_force_n(meshes), layout, classified_phi(layout), NOISE_N, rng).astype(np.float32)
    found = decisions(sums, [draw_split(number, *FULL, seed) for number in splits])
    return {"accuracy": [float(np.mean(said == true)) for said, true in found], "sums": sums.shape[1]}


def decisions(values: Values, splits: Sequence[Split]) -> Iterator[tuple[Indices, Indices]]:
    """Yield for each split what the paper's classifier, trained on the split, says of the test set, and the truth."""
    gram = np.asarray(values, np.float32) @ np.asarray(values, np.float32).T if values.shape[1] >= GRAM_FROM else None
    for split in splits:
        chosen, X = trained(values, split, gram)
        yield chosen.machine.predict(part_of(X, split.test, split.training, chosen.machine)), LABELS[split.test]


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
