"""The plain form of the compiled solvers: FISTA on the image, with a proximal step between two gradient steps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from reconstructor.bases import Basis
from reconstructor.checks import Values
from reconstructor.fista import iterate, momentum, soft
from skin.operator import Operator
from skin.surface import grid_surface


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

    def descent(ahead: Values) -> Values:
        return phi.adjoint(phi.forward(ahead.reshape(-1)) - sums_n).reshape(start.shape) / lipschitz

    made: Values = iterate(
        start, descent, lambda image, k: proximal(image, penalty_n / lipschitz, k), momentum(iterations)
    )
    return made


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
    """x ↦ nearly argmin ½‖u - x‖² + τ Σ |u[i] - u[j]| over the edges, u ≥ `floor`.

    `inner` projected gradient steps on the dual (Chambolle 2004), which starts from the dual of the last call. With
    many steps this converges to the proximal step. u = max(floor, x - Dᵀp), p ← clip(p + D u / bound, ±τ).

    `shape`: rows and columns of the images. `edges`: pairs of neighbours; without them those of the grid.
    """

    def __init__(
        self, shape: tuple[int, int], inner: int, *, nonnegative: bool = True, edges: npt.NDArray[np.intp] | None = None
    ) -> None:
        self._inner = inner
        self._floor = 0.0 if nonnegative else -np.inf
        self._edges = grid_surface(*shape, 1.0, np.zeros(0, np.intp)).edges if edges is None else edges
        degree = np.bincount(self._edges.ravel(), minlength=shape[0] * shape[1])
        self._bound = 8 if edges is None else max(2, degree[self._edges].sum(axis=1).max(initial=0))
        self._dual = np.zeros(len(self._edges))

    def __call__(self, image: Values, threshold_n: float, iteration: int) -> Values:
        """Return the smoothed image; `iteration` has no effect."""
        del iteration
        for _ in range(self._inner):
            low, high = self._smooth(image).reshape(-1)[self._edges].T
            self._dual = np.clip(self._dual + (high - low) / self._bound, -threshold_n, threshold_n)
        return self._smooth(image)

    def _smooth(self, image: Values) -> Values:
        smooth = image.astype(np.float64).reshape(-1)
        np.add.at(smooth, self._edges[:, 0], self._dual)
        np.subtract.at(smooth, self._edges[:, 1], self._dual)
        return np.maximum(smooth, self._floor).astype(image.dtype).reshape(image.shape)
