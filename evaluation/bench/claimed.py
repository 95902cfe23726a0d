"""Figures of the paper's claims on processing: the time of a decision."""

from typing import Any, Final

import numpy as np

from classifier.descent import descend
from evaluation.bench.timing import race
from evaluation.observations import OBJECTS, TAXELS
from evaluation.result import Finding, Options, Row
from evaluation.result_cache import measure_cells

#: Turns in which decisions are timed.
ROUNDS, QUICK_ROUNDS = 20, 5
SUMS: Final = 64


def claimed(options: Options) -> dict[str, Finding]:
    """Return how much longer a decision takes from all taxels than from sums."""
    asked = {"rounds": QUICK_ROUNDS if options.quick else ROUNDS, "seed": options.seed}
    (times,) = measure_cells(measure_decisions, [asked], options, "decisions", jobs=1)
    return {"decision": Finding(times["taxels_us"] / times["sums_us"], asked["rounds"])}


def measure_decisions(*, rounds: int, seed: int) -> Row:
    """Return the median time of one decision between the paper's objects, µs, from 64 sums and from 4096 taxels."""
    random, pairs = np.random.default_rng(seed), OBJECTS * (OBJECTS - 1) // 2

    def decision(size: int) -> Any:
        weights, biases, values = (random.standard_normal(shape) for shape in ((pairs, size), pairs, size))
        return lambda: descend(values, weights, biases, OBJECTS)

    sums_s, taxels_s = race([decision(SUMS), decision(TAXELS)], rounds)
    return {"sums_us": 1e6 * float(np.median(sums_s)), "taxels_us": 1e6 * float(np.median(taxels_s))}
