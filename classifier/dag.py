"""The decision graph over pairs of classes: M - 1 of the M (M - 1) / 2 pairs decide (Platt et al. 2000)."""

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]


def pairs(classes: int) -> list[tuple[int, int]]:
    """Return the pairs ``(i, j)``, i < j, of `classes` classes, in the order of the margins."""
    return [(first, second) for first in range(classes) for second in range(first + 1, classes)]


class DecisionGraph:
    """Walk from all classes to one class; every step evaluates a pair and excludes a class.

    Parameters
    ----------
    classes : int
        Number of classes M, at least 2.
    """

    def __init__(self, classes: int) -> None:
        self.classes = classes
        self._pair = np.zeros((classes, classes), np.intp)
        for index, pair in enumerate(pairs(classes)):
            self._pair[pair] = index

    def walk(self, margins: Float64) -> Iterator[tuple[int, float]]:
        """Yield (excluded class, absolute margin) at each step from the root to a leaf.

        Parameters
        ----------
        margins : array, shape (M (M - 1) / 2,)
            One signed margin per pair, positive for the first class of the pair.
        """
        low, high = 0, self.classes - 1
        while low < high:
            margin = float(margins[self._pair[low, high]])
            if margin >= 0:
                yield high, margin
                high -= 1
            else:
                yield low, -margin
                low += 1

    def decide(self, margins: Float64) -> tuple[int, float]:
        """Return the remaining class and a confidence in 0..1.

        The confidence is the product of ``1 / (1 + exp(-|margin|))`` over the evaluated pairs.
        """
        winner, confidence = self.classes * (self.classes - 1) // 2, 1.0
        for loser, margin in self.walk(margins):
            winner -= loser
            confidence /= 1.0 + math.exp(-margin)
        return winner, confidence

    def winners(self, margins: Float64) -> npt.NDArray[np.intp]:
        """Return the remaining class of every row of `margins`, shape (count, pairs)."""
        rows = np.arange(len(margins))
        low = np.zeros(len(margins), np.intp)
        high = np.full(len(margins), self.classes - 1, np.intp)
        for _ in range(self.classes - 1):
            first = margins[rows, self._pair[low, high]] >= 0
            high -= first
            low += ~first
        return low
