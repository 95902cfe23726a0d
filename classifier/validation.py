"""Choice of C on a validation set, then training on all data (section II-C of the paper)."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning

from classifier.dagsvm import DagSvm

Indices = npt.NDArray[np.intp]
#: Fewer touches of a label are told, and leave no accuracy; of fewer, no unknown objects are reported.
FEW_TOUCHES: Final = 10


def not_validated(touches: Mapping[str, int], recordings: Mapping[str, int]) -> dict[str, str]:
    """Return the labels because of which no accuracy of recorded touches holds, and why; empty if one holds.

    Touches of one recording have its day, place and person in common. So an accuracy holds when whole recordings were
    left out of the training, which takes two of each label. That of fewer than `FEW_TOUCHES` is chance.

    Parameters
    ----------
    touches, recordings : mapping of str to int
        Number of touches of each label, and of the recordings that have such touches.
    """
    told = {name: "one recording" if count < 2 else f"{count} recordings" for name, count in recordings.items()}
    return {
        name: f"{count} touches of this label, in {told[name]}"
        for name, count in touches.items()
        if count < FEW_TOUCHES or recordings[name] < 2
    }


class Chosen(NamedTuple):
    """A machine with the best C of a grid.

    Attributes
    ----------
    machine : DagSvm
        Trained on development and validation set together.
    development_machine : DagSvm
        Trained on the development set only; `accuracy` belongs to this machine.
    C, accuracy : float
        The smallest C with the best accuracy on the validation set, and this accuracy.
    """

    machine: DagSvm
    development_machine: DagSvm
    C: float
    accuracy: float


def choose_C(
    X: npt.NDArray[Any],
    labels: npt.NDArray[Any],
    development: Indices,
    validation: Indices,
    *,
    machine: DagSvm | None = None,
    C_grid: Sequence[float],
    progress: Callable[[str, float], None] | None = None,
) -> Chosen:
    """Train with every C of the grid on the development set, and keep the C with the best accuracy in validation.

    Parameters
    ----------
    X : array, shape (count, features), or (count, count) of inner products
        Observations, or their inner products when the machine's kernel is "precomputed".
    labels : array, shape (count,)
    development, validation : arrays of int
        Disjoint rows of `X`.
    C_grid : sequence of float
        Ascending.
    machine : DagSvm, optional
        Its other settings are used; default: linear, as in the paper.
    progress : callable, optional
        Called with the name of the step and the finished part, 0 to 1.
    """
    template = machine or DagSvm()
    tell = progress or (lambda _doing, _ratio: None)
    best: Chosen | None = None
    for step, C in enumerate(C_grid):
        tell(f"C = {C:g}", step / (len(C_grid) + 1))
        tried = _trained(clone(template).set_params(C=C), X, labels, development)
        accuracy = float(np.mean(tried.predict(part_of(X, validation, development, tried)) == labels[validation]))
        if best is None or accuracy > best.accuracy:
            best = Chosen(tried, tried, C, accuracy)
    if best is None:
        raise ValueError("expected at least one C to try")
    tell("the final fit", len(C_grid) / (len(C_grid) + 1))
    everything = np.concatenate([development, validation])
    return best._replace(machine=_trained(clone(best.development_machine), X, labels, everything))


def part_of(X: npt.NDArray[Any], rows: Indices, trained: Indices, machine: DagSvm) -> npt.NDArray[Any]:
    """Return the input of a machine trained on the rows `trained`, for a decision on the rows `rows`."""
    return X[np.ix_(rows, trained)] if machine.kernel == "precomputed" else X[rows]


def global_scale(X: npt.NDArray[Any]) -> float:
    """Return 1 / root mean square of all values: one scale for all features."""
    return 1.0 / (math.sqrt(float(np.mean(np.square(X, dtype=np.float64)))) or 1.0)


def _trained(machine: DagSvm, X: npt.NDArray[Any], labels: npt.NDArray[Any], rows: Indices) -> DagSvm:
    with warnings.catch_warnings():
        # Pairs that max_iter has stopped are validated like the others.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return machine.fit(part_of(X, rows, rows, machine), labels[rows])
