"""``skin bench classify``: one decision against scikit-learn's, on the same machines, in one run, on one thread."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from classifier.dag import Float64
from classifier.dagsvm import DagSvm
from classifier.descent import descend
from classifier.validation import global_scale
from evaluation.bench.timing import race
from evaluation.observations import LABELS, OBJECTS, draw_split, measured, phi_of, sensed

#: Sums per observation: the paper's 1:256, 1:64 and the default skin's 1:4.
SIZES: Final = (16, 64, 1024)
C: Final = 1.0
MOST_ITERATIONS: Final = 20_000
_SEED: Final = 0


def run(rounds: int) -> dict[str, Any]:
    """Return ``{"rows": […]}``: microseconds of one decision on one row, medians over `rounds`, for each size.

    ``ratio`` is scikit-learn's ``SVC.predict`` on one row to ours; ``same_labels`` tells whether every observation of
    the test set gets the label that `DagSvm.predict` gives it.
    """
    with threadpool_limits(1):
        return {"rows": [measure_size(size, rounds) for size in SIZES]}


def measure_size(size: int, rounds: int) -> dict[str, Any]:
    """Return the row of `run` for a number of sums."""
    split = draw_split(0, 0.4, 0.2, _SEED)
    values = measured(phi_of("sbhe", size, 0), sensed(None, _SEED)).astype(np.float64)
    values *= global_scale(values[split.development])
    machine = DagSvm(C, max_iter=MOST_ITERATIONS).fit(values[split.training], LABELS[split.training])
    test = np.ascontiguousarray(values[split.test])
    weights = np.ascontiguousarray(machine.weights_)

    def ours(one: Float64) -> int:
        return descend(one, weights, machine.biases_, OBJECTS)[0]

    sample = test[:: len(test) // 16]
    decisions: list[Callable[[Float64], Any]] = [ours, lambda one: machine.machine_.predict(one[None])]
    times_s = race([partial(_each, decide, sample) for decide in decisions], rounds)
    ours_us, peer_us = (1e6 * float(np.median(each)) / len(sample) for each in times_s)
    said = machine.classes_[[ours(one) for one in test]]
    return {
        "sums": size,
        "observations": len(test),
        "ours_us": ours_us,
        "sklearn_svc_us": peer_us,
        "ratio": peer_us / ours_us,
        "same_labels": bool(np.array_equal(said, machine.predict(test))),
        "accuracy": float(np.mean(said == LABELS[split.test])),
        "sklearn_accuracy": float(np.mean(machine.machine_.predict(test) == LABELS[split.test])),
    }


def _each(decide: Callable[[Float64], Any], sample: Float64) -> None:
    for one in sample:
        decide(one)
