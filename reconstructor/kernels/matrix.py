"""FISTA for any Φ, a dense matrix, and total variation with non-negative forces, as one compiled function.

Φ is an argument of each solve: it may change from frame to frame. The memory is the image before, from which a solve
starts, so it holds what earlier frames told through their own Φ.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import Values, check_estimate, float_kind, placed
from reconstructor.fista import momentum
from reconstructor.kernels.blocks import checked
from reconstructor.kernels.graph import Graph, Indices, graph_of
from reconstructor.kernels.steps import Step, aligned
from reconstructor.kernels.transforms import FAST_MATH, Flat
from reconstructor.kernels.variation import INNER, denoise
from reconstructor.settings import SolverSettings
from shell.compiled import njit
from skin.matrix import MatrixPhi
from skin.phi import Phi
from skin.ranges import require_number


class MatrixSolver:
    """min ½‖Φx - y‖² + λ TV(x) by FISTA, Φ any matrix; an estimate is the image, row by row.

    Sums of 0/1 codes feel the total force much more than its pattern: the iterations are then more by the root of
    largest / mean eigenvalue of ΦΦᵀ, rounded, which is 1 for an SBHE. With 40 sums of 100 taxels, 46 in place of 10
    iterations halve the error. With a Φ that changes each frame is one step of many, and has the iterations of the
    settings or fewer.

    With a Φ that changes, no start is scaled: a few sums of one frame tell too little of the image before. With 15 sums
    of 100 taxels, random 0/1 codes, scaled starts cost 3 dB.

    Parameters
    ----------
    phi : MatrixPhi
        Of any number of frames.
    rows, columns : int
        1 to 256.
    settings : SolverSettings
        Of total variation.
    edges : array of int, shape (edges, 2), optional
        As of `reconstructor.kernels.blocks.BlockSolver`.
    """

    def __init__(
        self,
        phi: MatrixPhi,
        rows: int,
        columns: int,
        settings: SolverSettings,
        *,
        edges: Indices | None = None,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        self.dtype: Final = float_kind(dtype)
        self.sums, taxels = phi.shape
        self.shape: Final = (rows, columns)
        if settings.prior != "variation" or not settings.nonnegative:
            got = f"'{settings.prior}'" if settings.prior != "variation" else "forces of any sign"
            raise InputError(f"a matrix is solved with total variation, and forces of 0 or more: got {got}")
        if rows * columns != taxels:
            raise InputError(f"Φ measures {taxels} taxels but the grid has {rows} x {columns} = {rows * columns}")
        self._phi, self._settings = phi, settings
        self._is_scaled = settings.scaled_start and phi.frames == 1
        self._graph = graph_of(rows, columns, np.flatnonzero(~phi.is_wired), edges)
        turns = settings.iterations * (_more_turns(phi) if phi.frames == 1 else 1)
        self._momentum = momentum(turns).astype(self.dtype)
        self._dual = np.zeros(self._graph.size, self.dtype)
        self._work = np.zeros((3, taxels), self.dtype)

    def new_estimate(self) -> Values:
        """Return an estimate of zeros, shape (n,)."""
        return aligned(self._phi.shape[1], self.dtype)

    def solve(
        self,
        estimate: Values,
        sums_n: Values,
        weights: Values,
        *,
        relative_penalty: float = 1.0,
        phi: Phi | None = None,
        part: float = 1.0,
    ) -> int:
        """Solve in place from `estimate` and return the number of sums used.

        Parameters
        ----------
        estimate : array of `dtype`, shape (n,)
            Start and result in newtons.
        sums_n, weights, relative_penalty
            As `reconstructor.kernels.blocks.BlockSolver.solve`.
        phi : MatrixPhi, optional
            That of these sums, with the shape of the first; default: the first.
        part : float
            Of the iterations, above 0 and at most 1; one iteration is made at least.
        """
        phi = phi or self._phi
        if not isinstance(phi, MatrixPhi) or phi.shape != self._phi.shape:
            raise InputError(f"expected a MatrixPhi of shape {self._phi.shape}, got {type(phi).__name__} {phi.shape}")
        check_estimate(estimate, self._phi.shape[1:], self.dtype)
        sums, counting = checked(sums_n, weights, (self.sums,), self.dtype)
        require_number("the relative penalty", relative_penalty)
        size, number = 1 / (self._settings.lipschitz_ratio * phi.norm_squared), self.dtype.type
        step = Step(number(size), number(self._settings.penalty_n * size * relative_penalty), number(0))
        matrix, memory = phi.dense.astype(self.dtype, copy=False), (self._dual, self._work)
        schedule = self._momentum[: max(1, round(part * self._momentum.size))], self._is_scaled
        return int(solve_matrix(estimate, sums, counting, matrix, step, schedule, self._graph, memory))

    def reset(self) -> None:
        """Clear the dual variable."""
        self._dual[:] = 0

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return a new image of shape (rows, columns), negative forces and gaps as 0."""
        kept = placed("estimate", estimate, self._phi.shape[1:], self.dtype)
        image: npt.NDArray[np.float32] = np.where(self._phi.is_wired, np.maximum(kept, 0), 0).astype(np.float32)
        return image.reshape(self.shape)


def _more_turns(phi: MatrixPhi) -> int:
    """Return the factor of the iterations: FISTA needs more in proportion to the root of the condition."""
    mean = np.count_nonzero(phi.entries) / min(phi.shape)
    return max(1, round(float(np.sqrt(phi.norm_squared / mean))))


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def solve_matrix(  # noqa: PLR0917
    estimate: Flat,
    sums: Flat,
    weights: Flat,
    matrix: Any,
    step: Step,
    schedule: tuple[Flat, bool],
    graph: Graph,
    memory: tuple[Any, Any],
) -> int:
    """Solve in place from `estimate` and return the number of sums used.

    Parameters
    ----------
    matrix : array, shape (m, n)
        Φ.
    schedule : tuple
        (t_k - 1) / t_{k+1} of each iteration, and whether the start is scaled, see `SolverSettings`.
    graph : Graph
        Neighbours.
    memory : tuple of arrays, shapes (graph.size,) and (3, n)
        The dual, kept from call to call, and scratch.
    """
    momenta, is_scaled = schedule
    dual, work = memory
    ahead, image, made = work[0], work[1], work[2]
    count = 0
    for k in range(sums.size):
        count += weights[k] > 0
    if is_scaled:
        _scale(estimate, dual, sums, weights, np.dot(matrix, estimate))
    ahead[:] = estimate
    for turn in range(momenta.size):
        residual = np.dot(matrix, ahead)
        for k in range(residual.size):  # a sum without weight may hold any value
            residual[k] = step.size * weights[k] * (residual[k] - sums[k]) if weights[k] > 0 else 0
        gradient = np.dot(residual, matrix)
        for k in range(image.size):
            image[k] = ahead[k] - gradient[k]
        denoise(image, made, dual, graph, INNER, step.threshold, step.floor)
        for k in range(made.size):
            ahead[k] = made[k] + momenta[turn] * (made[k] - estimate[k])
            estimate[k] = made[k]
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _scale(estimate: Flat, dual: Any, sums: Flat, weights: Flat, seen: Flat) -> None:
    """Scale a start and its dual by max(0, 2a - 1), a = argmin ‖a Φ estimate - y‖, at most 1; `seen` is Φ estimate."""
    explained = energy = estimate.dtype.type(0)
    for k in range(sums.size):
        if weights[k] > 0:
            felt = weights[k] * seen[k]
            explained += felt * weights[k] * sums[k]
            energy += felt * felt
    excess = explained + explained - energy
    if excess < energy:
        scale = max(estimate.dtype.type(0), excess / energy)
        estimate *= scale
        dual *= scale
