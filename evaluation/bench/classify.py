"""``skin bench classify``: one decision against scikit-learn's, on the same machines, in one run, on one thread."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from classifier.dag import DecisionGraph, Float64
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
    the test set gets the label that a walk of the graph, step by step, gives it.
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
    weights, biases, graph = np.ascontiguousarray(machine.weights_), machine.biases_, DecisionGraph(OBJECTS)

    def walk(one: Float64) -> int:
        return graph.decide(weights @ one + biases)[0]

    def ours(one: Float64) -> int:
        return descend(one, weights, biases, OBJECTS)[0]

    sample = test[:: len(test) // 16]
    decisions: list[Callable[[Float64], Any]] = [ours, walk, lambda one: machine.machine_.predict(one[None])]
    times_s = race([partial(_each, decide, sample) for decide in decisions], rounds)
    ours_us, walk_us, peer_us = (1e6 * float(np.median(each)) / len(sample) for each in times_s)
    return {
        "sums": size,
        "observations": len(test),
        "ours_us": ours_us,
        "plain_walk_us": walk_us,
        "sklearn_svc_us": peer_us,
        "ratio": peer_us / ours_us,
        "same_labels": all(ours(one) == walk(one) for one in test),
        "accuracy": float(np.mean([ours(one) for one in test] == LABELS[split.test])),
        "sklearn_accuracy": float(np.mean(machine.machine_.predict(test) == LABELS[split.test])),
    }


def _each(decide: Callable[[Float64], Any], sample: Float64) -> None:
    for one in sample:
        decide(one)
