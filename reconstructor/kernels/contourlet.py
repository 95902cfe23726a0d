"""The compiled solver for SBHE and the contourlet."""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.bases.contourlet import Contourlet
from reconstructor.checks import Values, check_estimate, check_sbhe, check_values, float_kind, placed
from reconstructor.fista import largest_eigenvalue, momentum
from reconstructor.kernels.blocks import checked, places_of_sums, taxels_in_block_order
from reconstructor.kernels.contourlet_tables import (
    ContourletBuffers,
    ContourletTables,
    coefficient_order,
    image_order,
    make_buffers,
    make_tables,
)
from reconstructor.kernels.contourlet_transform import synthesise, transpose
from reconstructor.kernels.steps import Step, Table, aligned, deliver, gather, load
from reconstructor.kernels.transforms import FAST_MATH, Flat, masked_gram
from reconstructor.settings import SolverSettings
from shell.compiled import njit
from skin.phi import Sbhe
from skin.ranges import require_number


class _Problem(NamedTuple):
    """`places` of sums, orders of the taxels, and momentum, as in `reconstructor.kernels.steps.Problem`."""

    places: Table
    to_image: Table
    to_blocks: Table
    momentum: Flat
    blocks: int


class _Scratch(NamedTuple):
    """Gain, target and work in block order; the image; ahead and gradient of the coefficients."""

    gain: Flat
    target: Flat
    work: Flat
    image: Flat
    ahead: Flat
    slope: Flat


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _solve(  # noqa: PLR0917  compiled functions take no keywords
    estimate: Flat,
    sums: Flat,
    weights: Flat,
    problem: _Problem,
    step: Step,
    tables: ContourletTables,
    scratch: _Scratch,
    buffers: ContourletBuffers,
) -> int:
    gain, target, work, image, ahead, slope = scratch
    count = load(sums, weights, problem.places, step.size, gain, target)
    ahead[:] = estimate
    for turn in range(problem.momentum.size):
        synthesise(image, ahead, tables, buffers)
        gather(work, image, problem.to_blocks)
        masked_gram(work, gain, target, problem.blocks)
        gather(image, work, problem.to_image)
        transpose(slope, image, tables, buffers)
        advance_coefficients(estimate, ahead, slope, step.threshold, problem.momentum[turn])
    return count


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def advance_coefficients(estimate: Flat, ahead: Flat, slope: Flat, threshold: Any, momentum: Any) -> None:
    """Set the estimate to the shrunken step down `slope`, and `ahead` to the next point."""
    for k in range(estimate.size):
        moved = ahead[k] - slope[k]
        new = moved - max(-threshold, min(threshold, moved))
        ahead[k] = new + momentum * (new - estimate[k])
        estimate[k] = new


class CompiledContourlet(Contourlet):
    """The contourlet as a `reconstructor.bases.Basis` of one dtype, compiled."""

    def __init__(self, rows: int, columns: int, dtype: npt.DTypeLike = np.float64) -> None:
        super().__init__(rows, columns)
        self._kind = float_kind(dtype)
        self._tables = make_tables(self, self._kind)
        self._buffers = make_buffers(self._tables, self._kind)
        self._pixels, self._order = image_order(rows), coefficient_order(self)

    def forward(self, image: Values) -> Values:
        """Return Ψᵀx, shape (5n/4,)."""
        check_values("image", image, self.image_shape)
        made = aligned(self._order.size, self._kind)
        kept = image.reshape(-1)[self._pixels].astype(self._kind, copy=False)
        transpose(made, kept, self._tables, self._buffers)
        return made[self._order]

    def adjoint(self, coefficients: Values) -> Values:
        """Return x = Ψs, shape (rows, columns)."""
        check_values("coefficients", coefficients, self.shape)
        kept, made = np.empty_like(coefficients, self._kind), aligned(self._pixels.size, self._kind)
        kept[self._order] = coefficients
        synthesise(made, kept, self._tables, self._buffers)
        image = np.empty_like(made)
        image[self._pixels] = made
        return image.reshape(self.image_shape)


class ContourletSolver:
    """min over s of ½‖ΦΨs - y‖² + λ‖s‖₁ by FISTA, Φ an SBHE and Ψ the contourlet; equal to `reconstructor.fista.fista`.

    Parameters
    ----------
    rows, columns : int
        Equal, a power of two, 16 to 256.
    settings : SolverSettings
        With the prior "contourlet"; L is `lipschitz_ratio` times the largest eigenvalue of (ΦΨ)ᵀΦΨ, which is computed.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        settings: SolverSettings,
        *,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        if settings.prior != "contourlet":
            raise InputError(f"expected the prior 'contourlet', got '{settings.prior}': use make_solver")
        check_sbhe(phi)
        self.dtype: Final = float_kind(dtype)
        psi = CompiledContourlet(rows, columns)
        self.lipschitz: Final = settings.lipschitz_ratio * largest_eigenvalue(phi, psi)
        self.shape: Final = psi.image_shape
        self.sums: Final = phi.shape[0]
        taxel = taxels_in_block_order(phi)
        place = np.argsort(image_order(rows))
        to_blocks = place[taxel]
        self._threshold = settings.penalty_n / self.lipschitz
        self._problem = _Problem(
            places=places_of_sums(phi),
            to_image=np.argsort(to_blocks).astype(np.uint16),
            to_blocks=to_blocks.astype(np.uint16),
            momentum=momentum(settings.iterations).astype(self.dtype),
            blocks=phi.blocks,
        )
        self._tables = make_tables(psi, self.dtype)
        self._buffers = make_buffers(self._tables, self.dtype)
        sizes = (taxel.size,) * 4 + psi.shape * 2
        self._scratch = _Scratch(*(aligned(size, self.dtype) for size in sizes))
        self._order = coefficient_order(psi)
        self._deliver = place.astype(np.uint16)

    def new_estimate(self) -> Values:
        """Return coefficients of zeros, shape (5n/4,), in the kernel's order (`coefficients_of`)."""
        return aligned(self._order.size, self.dtype)

    def solve(self, estimate: Values, sums_n: Values, weights: Values, *, relative_penalty: float = 1.0) -> int:
        """Solve in place from `estimate` and return the number of sums used; raises like `BlockSolver.solve`."""
        check_estimate(estimate, self._order.shape, self.dtype)
        sums, counting = checked(sums_n, weights, (self.sums,), self.dtype)
        require_number("the relative penalty", relative_penalty)
        number = self.dtype.type
        step = Step(number(1 / self.lipschitz), number(self._threshold * relative_penalty), number(0))
        return int(_solve(estimate, sums, counting, self._problem, step, self._tables, self._scratch, self._buffers))

    def reset(self) -> None:
        """Do nothing: this solver has no state besides the estimate."""

    def coefficients_of(self, estimate: Values) -> Values:
        """Return an estimate in the toolbox's order."""
        check_values("estimate", estimate, self._order.shape)
        return estimate[self._order]

    def estimate_of(self, coefficients: Values) -> Values:
        """Return coefficients in the toolbox's order as an estimate."""
        check_values("coefficients", coefficients, self._order.shape)
        estimate = self.new_estimate()
        estimate[self._order] = coefficients
        return estimate

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return a new image of shape (rows, columns), negative forces as 0."""
        kept = placed("estimate", estimate, self._order.shape, self.dtype)
        synthesise(self._scratch.image, kept, self._tables, self._buffers)
        image = np.empty(self.shape, np.float32)
        deliver(image.reshape(-1), self._scratch.image, self._deliver)
        return image
