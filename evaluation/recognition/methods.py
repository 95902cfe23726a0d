"""Ways to recognise objects from the same sums and the same training perturbations, the paper's among them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from sklearn.discriminant_analysis import QuadraticDiscriminantAnalysis

from classifier.dagsvm import DagSvm
from classifier.missing import Completion, fit_factors
from classifier.rows import choose_rows
from classifier.validation import choose_C, global_scale
from evaluation.observations import LABELS, Split, all_rows, draw_split, drawn_sbhe, measured, sensed
from evaluation.recognition.accuracy import FULL, score, trained
from evaluation.result import Row
from reconstructor.checks import Values
from skin.measurement import Sbhe

CYCLES: Final = 4
LOST_RATIO: Final = 0.1
_C_GRID: Final = (1.0, 10.0, 100.0)
_GAMMAS: Final = (0.03, 0.1, 0.3)
_SHRINKAGES: Final = (1e-3, 1e-2, 1e-1)


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


def _gaussian_kernel(task: _Task) -> float:
    best = max(
        (
            choose_C(
                task.scaled,
                LABELS,
                task.split.development,
                task.split.validation,
                machine=DagSvm(kernel="rbf", gamma=gamma),
                C_grid=_C_GRID,
            )
            for gamma in _GAMMAS
        ),
        key=lambda chosen: chosen.accuracy,
    )
    return score(best.machine.predict, task.scaled, task.split)


def _products(task: _Task) -> float:
    """Linear, on the sums and the products of every two of them."""
    sums = task.scaled
    first, second = np.triu_indices(sums.shape[1])
    wide = np.concatenate([sums, sums[:, first] * sums[:, second]], axis=1)
    chosen, X = trained(wide, task.split)
    return score(chosen.machine.predict, X, task.split)


def _quadratic(task: _Task) -> float:
    """Fit a Gaussian to every object, its covariance shrunk as the validation set likes it."""
    X, split = task.scaled, task.split

    def fitted(shrinkage: float, rows: Any) -> QuadraticDiscriminantAnalysis:
        return QuadraticDiscriminantAnalysis(reg_param=shrinkage).fit(X[rows], LABELS[rows])

    rated = {
        shrinkage: float(
            np.mean(fitted(shrinkage, split.development).predict(X[split.validation]) == LABELS[split.validation])
        )
        for shrinkage in _SHRINKAGES
    }
    return score(fitted(max(rated, key=rated.__getitem__), split.training).predict, X, split)


def _cycles(task: _Task) -> float:
    """Trained on single cycles as ever, asked about the mean of some."""
    chosen, _ = trained(task.values, task.split)
    scale = global_scale(task.values[task.split.development])
    return score(chosen.machine.predict, task.mean_of_cycles() * scale, task.split)


def _lost(task: _Task, count: int, stream: int) -> Any:
    """Return which sums of `count` observations are there when a part of the blocks is missing, drawn for each."""
    rng = np.random.default_rng([task.seed, task.draw, stream])
    order = np.argsort(rng.random((count, task.phi.blocks)), axis=1)
    return (order >= round(LOST_RATIO * task.phi.blocks))[:, task.phi.block_of_sum]


def _with_loss(task: _Task, fill: Callable[[Values, Any, Values], Values], *, rehearsed: bool) -> float:
    """Return the accuracy with missing blocks, their sums filled in; `rehearsed`: trained with such losses as well."""
    X, split = task.scaled, task.split
    training = X[split.training]
    chosen, _ = trained(task.values, split)
    machine = chosen.machine
    if rehearsed:
        spoilt = fill(training, _lost(task, len(training), 0), training)
        labels = LABELS[split.training]
        machine = DagSvm(chosen.C).fit(np.concatenate([training, spoilt]), np.concatenate([labels, labels]))
    test = fill(X[split.test], _lost(task, len(split.test), 1), training)
    return float(np.mean(machine.predict(test) == LABELS[split.test]))


def _as_zero(sums: Values, there: Any, _training: Values) -> Values:
    return np.where(there, sums, 0)


def _as_mean(sums: Values, there: Any, training: Values) -> Values:
    return np.where(there, sums, training.mean(axis=0))


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
    "products of the sums as features": _products,
    "Gaussian kernel": _gaussian_kernel,
    "quadratic discriminant": _quadratic,
    f"asked about the mean of {CYCLES} cycles": _cycles,
    "rows chosen": lambda task: _linear(task.with_chosen_rows()),
    "rows chosen, Gaussian kernel": lambda task: _gaussian_kernel(task.with_chosen_rows()),
    f"rows chosen, mean of {CYCLES} cycles": lambda task: _cycles(task.with_chosen_rows()),
    "10 % missing: as 0": lambda task: _with_loss(task, _as_zero, rehearsed=False),
    "10 % missing: as 0, rehearsed": lambda task: _with_loss(task, _as_zero, rehearsed=True),
    "10 % missing: as the mean": lambda task: _with_loss(task, _as_mean, rehearsed=False),
    "10 % missing: as the mean, rehearsed": lambda task: _with_loss(task, _as_mean, rehearsed=True),
    "10 % missing: estimated": lambda task: _with_loss(task, _estimated, rehearsed=False),
    "10 % missing: estimated, rehearsed": lambda task: _with_loss(task, _estimated, rehearsed=True),
}
