"""Proximal steps: what FISTA does to an estimate between two gradient steps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from reconstructor.bases import Basis

Values = npt.NDArray[np.floating[Any]]


class Proximal(Protocol):
    """Take an image, how far to shrink, and the number of the iteration, from 0; return a likelier image."""

    def __call__(self, image: Values, threshold_n: float, iteration: int) -> Values:
        """Return a new image of the same shape."""
        ...


def soft(values: Values, threshold: float) -> Values:
    """Return sign(v) · max(|v| - threshold, 0), the proximal step of threshold · ‖·‖₁."""
    return values - np.clip(values, -threshold, threshold)


@dataclass(frozen=True)
class Shrinkage:
    """x ↦ Ψ soft(Ψᵀx) for an orthonormal Ψ, moved by one of `shifts` in each iteration.

    With one shift this is the exact proximal step of λ‖Ψᵀx‖₁. With many (cycle spinning, Coifman and Donoho 1995)
    the blocky pattern of a single Haar grid averages out. `nonnegative` then lifts negative taxels to 0; the two
    together are no longer the proximal step of a sum, only two steps after each other.
    """

    psi: Basis
    shifts: Sequence[tuple[int, int]] = ((0, 0),)
    nonnegative: bool = False

    def __call__(self, image: Values, threshold_n: float, iteration: int) -> Values:
        """Return the shrunken image."""
        down, right = self.shifts[iteration % len(self.shifts)]
        moved = np.roll(image, (down, right), axis=(0, 1))
        shrunken = self.psi.adjoint(soft(self.psi.forward(moved), threshold_n))
        result = np.roll(shrunken, (-down, -right), axis=(0, 1))
        return np.maximum(result, 0) if self.nonnegative else result
