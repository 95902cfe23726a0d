"""The compiled solvers for the noiselet, with the tensor Haar and with the contourlet.

Both priors keep the image with its rows, and its columns, in an order of their own. N_R ⊗ N_C does not mind: its
butterflies pair whole rows, wherever they stand. So unlike with the SBHE nothing is gathered between Φ and Ψ.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from evaluation.solvers.noiselet import Noiselet, butterflies
from reconstructor.checks import Values, check_estimate, placed
from reconstructor.fista import largest_eigenvalue, momentum
from reconstructor.kernels.addresses import tensor_addresses
from reconstructor.kernels.contourlet import CompiledContourlet, advance_coefficients
from reconstructor.kernels.contourlet_tables import (
    ContourletBuffers,
    ContourletTables,
    image_order,
    make_buffers,
    make_tables,
)
from reconstructor.kernels.contourlet_transform import synthesise, transpose
from reconstructor.kernels.haar import shrink_tensor
from reconstructor.kernels.problem import checked
from reconstructor.kernels.steps import aligned, deliver, load
from reconstructor.kernels.transforms import FAST_MATH, Flat, transpose_image
from reconstructor.settings import SolverSettings
from shell.compiled import njit

Table = npt.NDArray[np.uint16]
Steps = npt.NDArray[np.int64]


class _Problem(NamedTuple):
    """What stays the same from solve to solve.

    Attributes
    ----------
    places : shape (m,)
        Place of every sum in the transformed image, which is kept transposed.
    down, across : shape (steps, 2, rows / 2) and (steps, 2, columns / 2)
        Which rows, and which columns, every step of the noiselet pairs.
    numbers : shape (3,)
        1 / L, λ / L and the 1 / √2 of the Haar transform.
    momentum : shape (iterations,)
    rows, columns : int
    """

    places: Table
    down: Steps
    across: Steps
    numbers: Flat
    momentum: Flat
    rows: int
    columns: int


class _Scratch(NamedTuple):
    """Gain and target of the transformed image, that image, one more, and ahead and slope of what is solved for."""

    gain: Flat
    target: Flat
    turned: Flat
    image: Flat
    ahead: Flat
    slope: Flat


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _butterflies(work: Flat, pairs: Steps, width: int) -> None:
    """Apply N to every column of ``work.reshape(-1, width)``; the first step adds where the others subtract."""
    for step in range(len(pairs)):
        for k in range(pairs.shape[2]):
            p = work[pairs[step, 0, k] * width : (pairs[step, 0, k] + 1) * width]
            q = work[pairs[step, 1, k] * width : (pairs[step, 1, k] + 1) * width]
            if step == 0:
                for i in range(width):
                    p[i], q[i] = p[i] + q[i], p[i] - q[i]
            else:
                for i in range(width):
                    p[i], q[i] = p[i] - q[i], p[i] + q[i]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _gram(work: Flat, problem: _Problem, scratch: _Scratch) -> None:
    """Replace the image by Φᵀ(Φ work - y) / L, with the rows of weight 0 left out."""
    turned = scratch.turned
    _butterflies(work, problem.down, problem.columns)
    transpose_image(turned, work, problem.rows, problem.columns)
    _butterflies(turned, problem.across, problem.rows)
    for k in range(turned.size):
        turned[k] = scratch.gain[k] * turned[k] - scratch.target[k]
    _butterflies(turned, problem.across, problem.rows)
    transpose_image(work, turned, problem.columns, problem.rows)
    _butterflies(work, problem.down, problem.columns)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _solve_haar(estimate: Flat, sums: Flat, weights: Flat, problem: _Problem, scratch: _Scratch) -> int:
    count = load(sums, weights, problem.places, problem.numbers[0], scratch.gain, scratch.target)
    ahead, slope = scratch.ahead, scratch.slope
    ahead[:] = estimate
    for turn in range(problem.momentum.size):
        slope[:] = ahead
        _gram(slope, problem, scratch)
        for k in range(slope.size):
            slope[k] = ahead[k] - slope[k]
        shrink_tensor(slope, problem.columns, problem.numbers[1], problem.numbers[2])
        for k in range(slope.size):
            ahead[k] = slope[k] + problem.momentum[turn] * (slope[k] - estimate[k])
            estimate[k] = slope[k]
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _solve_contourlet(  # noqa: PLR0917  compiled functions take no keywords
    estimate: Flat,
    sums: Flat,
    weights: Flat,
    problem: _Problem,
    scratch: _Scratch,
    plan: ContourletTables,
    room: ContourletBuffers,
) -> int:
    count = load(sums, weights, problem.places, problem.numbers[0], scratch.gain, scratch.target)
    ahead, slope = scratch.ahead, scratch.slope
    threshold = problem.numbers[1]
    ahead[:] = estimate
    for turn in range(problem.momentum.size):
        synthesise(scratch.image, ahead, plan, room)
        _gram(scratch.image, problem, scratch)
        transpose(slope, scratch.image, plan, room)
        advance_coefficients(estimate, ahead, slope, threshold, problem.momentum[turn])
    return count


class NoiseletSolver:
    """min ½‖Φx - y‖² + λ‖s‖₁, x = Ψs, by FISTA, Φ a noiselet; equal to `reconstructor.fista.fista`.

    Parameters
    ----------
    phi : Noiselet
        Of a grid of powers of two, 8 to 256; of a square from 16 for the contourlet.
    settings : SolverSettings
        Of the prior "haar-tensor" or "contourlet"; L is `lipschitz_ratio` times the largest eigenvalue of (ΦΨ)ᵀΦΨ.
    """

    def __init__(self, phi: Noiselet, settings: SolverSettings, *, dtype: npt.DTypeLike = np.float32) -> None:
        self.dtype: Final = np.dtype(dtype)
        self.shape: Final = (phi.rows, phi.columns)
        self.sums: Final = phi.shape[0]
        count = phi.shape[1]
        if settings.prior == "contourlet":
            psi = CompiledContourlet(phi.rows, phi.columns)
            largest = largest_eigenvalue(phi, psi)
            places = np.argsort(image_order(phi.rows)).reshape(self.shape)
            self._size = psi.shape[0]
            plan = make_tables(psi, self.dtype)
            self._more: tuple[Any, ...] = (plan, make_buffers(plan, self.dtype))
        else:
            largest = phi.norm_squared
            places = tensor_addresses(phi.rows, phi.columns)
            self._size = count
            self._more = ()
        self.lipschitz: Final = settings.lipschitz_ratio * largest
        self._run: Callable[..., int] = _solve_contourlet if self._more else _solve_haar
        self._places = places.astype(np.uint16).ravel()
        self._problem = self._problem_of(phi, places, settings)
        sizes = (count,) * 4 + (self._size,) * 2
        self._scratch = _Scratch(*(aligned(size, self.dtype) for size in sizes))

    def _problem_of(self, phi: Noiselet, places: npt.NDArray[np.intp], settings: SolverSettings) -> _Problem:
        row_at, column_at = places[:, 0] // phi.columns, places[0]
        step = 1 / self.lipschitz
        return _Problem(
            places=(column_at[phi.kept % phi.columns] * phi.rows + row_at[phi.kept // phi.columns]).astype(np.uint16),
            down=np.array([(row_at[first], row_at[last]) for first, last in butterflies(phi.rows)]),
            across=np.array([(column_at[first], column_at[last]) for first, last in butterflies(phi.columns)]),
            numbers=np.array((step, settings.penalty_n * step, 0.5**0.5), self.dtype),
            momentum=momentum(settings.iterations).astype(self.dtype),
            rows=phi.rows,
            columns=phi.columns,
        )

    def new_estimate(self) -> Values:
        """Return an image of zeros, shape (n,), or coefficients of zeros, shape (5n/4,), in the kernel's order."""
        return aligned(self._size, self.dtype)

    def solve(self, estimate: Values, sums_n: Values, weights: Values) -> int:
        """Improve `estimate` in place and return how many sums count.

        Parameters
        ----------
        estimate : array of `dtype`
            From `new_estimate`, or the result of the solve before.
        sums_n, weights : arrays of `dtype`, shape (m,)
            Newtons, and how much each sum counts, 0 to 1.
        """
        check_estimate(estimate, (self._size,), self.dtype)
        sums, counting = checked(sums_n, weights, (self.sums,), self.dtype)
        return int(self._run(estimate, sums, counting, self._problem, self._scratch, *self._more))

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return a new image of shape (rows, columns), negative forces as 0."""
        kept = placed("estimate", estimate, (self._size,), self.dtype)
        if self._more:
            synthesise(self._scratch.image, kept, *self._more)
            kept = self._scratch.image
        image = np.empty(self.shape, np.float32)
        deliver(image.reshape(-1), kept, self._places)
        return image
