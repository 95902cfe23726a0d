"""Ways to recognise objects from the same sums and the same training perturbations, the paper's among them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from classifier.missing import Completion, fit_factors
from classifier.rows import choose_rows
from classifier.validation import global_scale
from evaluation.observations import LABELS, Split, all_rows, draw_split, drawn_sbhe, measured, sensed
from evaluation.recognition.accuracy import FULL, score, trained
from evaluation.result import Row
from reconstructor.checks import Values
from skin.phi import Sbhe

CYCLES: Final = 4
LOST_RATIO: Final = 0.1


def measure_method(*, method: str, size: int, draw: int, splits: Sequence[int], meshes: str | None, seed: int) -> Row:
    """Return the accuracy of one of `METHODS` on the test set of each split, and that of the paper's on the same sums.

    The sums are those of an SBHE, see `evaluation.observations.signal`.
    """
    phi = drawn_sbhe(size, draw)
    values = measured(phi, sensed(meshes, seed))
    accuracies, plain = [], []
    for number in splits:
        split = draw_split(number, *FULL, seed)
        chosen, X = trained(values, split)
        plain.append(score(chosen.machine.predict, X, split))
        accuracies.append(METHODS[method](_Task(phi, values, split, draw, meshes, seed)))
    return {"accuracy": accuracies, "plain": plain}


@dataclass(frozen=True, eq=False)
class _Task:
    """The sums of every observation, and what else a method may ask for."""

    phi: Sbhe
    values: Values
    split: Split
    draw: int
    meshes: str | None
    seed: int

    @property
    def scaled(self) -> Values:
        return self.values * global_scale(self.values[self.split.development])

    def with_chosen_rows(self) -> "_Task":
        """Return the task with rows chosen on the training perturbations, as many of the same scrambled blocks."""
        every, rows = all_rows(self.draw), self.split.training
        candidates = every.forward(sensed(self.meshes, self.seed)[rows])
        phi = choose_rows(every, candidates, LABELS[rows], self.phi.shape[0])
        return replace(self, phi=phi, values=measured(phi, sensed(self.meshes, self.seed)))

    def mean_of_cycles(self) -> Values:
        """Return the sums' mean over some cycles of each touch; the first is the one that `values` holds."""
        cycles = [measured(self.phi, sensed(self.meshes, self.seed, cycle)) for cycle in range(CYCLES)]
        mean: Values = np.mean(cycles, axis=0)
        return mean


def _linear(task: _Task) -> float:
    chosen, X = trained(task.values, task.split)
    return score(chosen.machine.predict, X, task.split)


def _cycles(task: _Task) -> float:
    """Trained on single cycles as ever, asked about the mean of some."""
    chosen, _ = trained(task.values, task.split)
    scale = global_scale(task.values[task.split.development])
    return score(chosen.machine.predict, task.mean_of_cycles() * scale, task.split)


def _lost(task: _Task, count: int) -> Any:
    """Return which sums of `count` observations are there when a part of the blocks is missing, drawn for each."""
    rng = np.random.default_rng([task.seed, task.draw, 1])
    order = np.argsort(rng.random((count, task.phi.blocks)), axis=1)
    return (order >= round(LOST_RATIO * task.phi.blocks))[:, task.phi.block_of_sum]


def _with_loss(task: _Task, fill: Callable[[Values, Any, Values], Values]) -> float:
    """Return the accuracy with missing blocks, their sums filled in."""
    X, split = task.scaled, task.split
    chosen, _ = trained(task.values, split)
    test = fill(X[split.test], _lost(task, len(split.test)), X[split.training])
    return float(np.mean(chosen.machine.predict(test) == LABELS[split.test]))


def _as_zero(sums: Values, there: Any, _training: Values) -> Values:
    return np.where(there, sums, 0)


def _estimated(sums: Values, there: Any, training: Values) -> Values:
    filled = np.array(sums, np.float64)
    completion = Completion(fit_factors(np.asarray(training, np.float64)))
    for one, present in zip(filled, there, strict=True):
        completion.complete(one, present)
    return filled


PLAIN: Final = "DAGSVM, the paper's"
#: Every method by its name in the table.
METHODS: Final[dict[str, Callable[[_Task], float]]] = {
    PLAIN: _linear,
    f"asked about the mean of {CYCLES} cycles": _cycles,
    "rows chosen": lambda task: _linear(task.with_chosen_rows()),
    f"rows chosen, mean of {CYCLES} cycles": lambda task: _cycles(task.with_chosen_rows()),
    "10 % missing: as 0": lambda task: _with_loss(task, _as_zero),
    "10 % missing: estimated": lambda task: _with_loss(task, _estimated),
}
