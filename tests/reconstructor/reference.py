"""The plain form of the compiled solvers: FISTA on the image, with a proximal step between two gradient steps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from reconstructor.bases import Basis
from reconstructor.checks import Values
from reconstructor.fista import momentum, soft
from skin.operator import Operator


class Proximal(Protocol):
    """Proximal step of an image; arguments: image, threshold, number of the iteration from 0."""

    def __call__(self, image: Values, threshold_n: float, iteration: int) -> Values:
        """Return a new image of the same shape."""
        ...


def fista_image(
    phi: Operator,
    proximal: Proximal,
    sums_n: Values,
    *,
    penalty_n: float,
    lipschitz: float,
    iterations: int,
    start: Values,
) -> Values:
    """Return the image x, shape (rows, columns): `fista` with `proximal` in place of the shrinkage of coefficients.

    The same iteration as `fista` when `proximal` shrinks the coefficients of one orthonormal Ψ.
    """
    estimate = ahead = start
    for k, weight in enumerate(momentum(iterations)):
        gradient = phi.adjoint(phi.forward(ahead.reshape(-1)) - sums_n).reshape(start.shape)
        previous, estimate = estimate, proximal(ahead - gradient / lipschitz, penalty_n / lipschitz, k)
        ahead = estimate + weight * (estimate - previous)
    return estimate


@dataclass(frozen=True)
class Shrinkage:
    """x ↦ Ψ soft(Ψᵀx) for an orthonormal Ψ, moved by one of `shifts` in each iteration.

    With one shift this is the exact proximal step of λ‖Ψᵀx‖₁. With many shifts (cycle spinning, Coifman and Donoho
    1995) the block pattern of the Haar grid averages out. `nonnegative` then sets negative taxels to 0; both steps
    together are not the proximal step of a sum.
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


class Variation:
    """x ↦ nearly argmin ½‖u - x‖² + τ Σ |u[i+1, j] - u[i, j]| + |u[i, j+1] - u[i, j]|, u ≥ `floor`.

    `inner` projected gradient steps on the dual (Chambolle 2004), which starts from the dual of the last call. With
    many steps this converges to the proximal step. u = max(floor, x - Dᵀp), p ← clip(p + D u / 8, ±τ).

    `shape`: rows and columns of the images.
    """

    def __init__(self, shape: tuple[int, int], inner: int, *, nonnegative: bool = True) -> None:
        self._inner = inner
        self._floor = 0.0 if nonnegative else -np.inf
        self._down = np.zeros((shape[0] - 1, shape[1]))
        self._right = np.zeros((shape[0], shape[1] - 1))

    def __call__(self, image: Values, threshold_n: float, iteration: int) -> Values:
        """Return the smoothed image; `iteration` has no effect."""
        del iteration
        for _ in range(self._inner):
            smooth = self._smooth(image)
            self._down = np.clip(self._down + np.diff(smooth, axis=0) / 8, -threshold_n, threshold_n)
            self._right = np.clip(self._right + np.diff(smooth, axis=1) / 8, -threshold_n, threshold_n)
        return self._smooth(image)

    def _smooth(self, image: Values) -> Values:
        smooth = image.astype(np.float64)
        smooth[:-1] += self._down
        smooth[1:] -= self._down
        smooth[:, :-1] += self._right
        smooth[:, 1:] -= self._right
        return np.maximum(smooth, self._floor).astype(image.dtype)
