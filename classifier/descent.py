"""The walk through the decision graph, compiled; a hyperplane is evaluated only when needed."""

import math
from collections.abc import Callable

from classifier.dag import Float64
from shell.compiled import njit


def _descend(features: Float64, weights: Float64, biases: Float64, classes: int) -> tuple[int, float]:
    low, high, confidence = 0, classes - 1, 1.0
    while low < high:
        pair = low * (2 * classes - low - 1) // 2 + high - low - 1
        margin = biases[pair]
        for index in range(features.size):
            margin += weights[pair, index] * features[index]
        if margin >= 0:
            high -= 1
        else:
            low += 1
        confidence /= 1.0 + math.exp(-abs(margin))
    return low, confidence


#: ``descend(features, weights, biases, classes)``: the class of `classifier.dag.walked` and a confidence in 0..1, the
#: product of ``1 / (1 + exp(-margin))`` over the path, from the features of one observation and the hyperplanes of all
#: pairs, without memory allocation.
descend: Callable[[Float64, Float64, Float64, int], tuple[int, float]] = njit(cache=True, fastmath=True)(_descend)
