"""The compiled solver for one Φ and one prior."""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import Values, check_estimate, check_values, float_kind, placed
from reconstructor.kernels import haar, variation
from reconstructor.kernels.addresses import Indices, spin_shifts
from reconstructor.kernels.problem import checked, make_problem, taxels_in_block_order
from reconstructor.kernels.steps import aligned, deliver, scratch_of
from reconstructor.settings import SolverSettings
from skin.measurement import Sbhe
from skin.ranges import require_number


class _Kernel(NamedTuple):
    """A compiled solver: its function, its rows of working memory, and whether the dual, which follows, is state."""

    solve: Callable[..., int]
    scratch_rows: int
    has_dual: bool = False


_HAAR: Final = _Kernel(haar.solve_haar, haar.SCRATCH_ROWS)
_KERNELS: Final[dict[str, _Kernel]] = {
    "haar-pyramid": _HAAR,
    "haar-tensor": _HAAR,
    "variation": _Kernel(variation.solve_variation, variation.SCRATCH_ROWS, has_dual=True),
}
#: The priors of `FusedSolver`.
COMPILED: Final = tuple(_KERNELS)


class FusedSolver:
    """min ½‖Φx - y‖² + λ R(x) by FISTA, Φ an SBHE.

    R is ‖Ψᵀx‖₁ of a Haar wavelet or the anisotropic total variation, compiled as a whole, for one thread and without
    allocation. `reconstructor.array_api.BatchSolver` has any other orthonormal wavelet.
    The iteration is over the image, not over its coefficients. For an orthonormal Ψ both iterations are the same, and
    shifts of the basis and non-negativity need no extra time.

    Parameters
    ----------
    phi : Sbhe
        Any block size.
    rows, columns : int
        1 to 256; for a wavelet powers of two from 8.
    settings : SolverSettings
        Of total variation, ``haar-pyramid`` or ``haar-tensor``.
    edges : array of int, shape (edges, 2), optional
        Pairs of neighbours of a skin that is no grid (`skin.surface.Surface.graph`); for total variation.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        settings: SolverSettings,
        *,
        edges: Indices | None = None,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        self.dtype: Final = float_kind(dtype)
        if settings.prior not in COMPILED:
            raise InputError(f"expected one of {', '.join(COMPILED)}, got '{settings.prior}'")
        self._problem = make_problem(phi, rows, columns, settings, self.dtype, edges)
        self._phi = phi
        self.shape: Final = (rows, columns)
        self.sums: Final = phi.shape[0]
        self.shifts: Final = spin_shifts(settings.spins, rows, columns)
        self._kernel = _KERNELS[settings.prior]
        self._taxel = taxels_in_block_order(phi)
        self._threshold = settings.penalty_n / (settings.lipschitz_ratio * phi.block_size)
        dual = self._problem.graph.size if self._kernel.has_dual else 0
        self._scratch = scratch_of(self._kernel.scratch_rows, max(phi.order.size, phi.taxels), self.dtype, dual)
        self._dual = self._scratch[self._scratch.size - dual :]
        self._is_gap = ~phi.is_wired

    def new_estimate(self) -> Values:
        """Return an estimate of zeros, shape (places,), aligned in memory."""
        return aligned(self._taxel.size, self.dtype)

    def solve(self, estimate: Values, sums_n: Values, weights: Values, *, relative_penalty: float = 1.0) -> int:
        """Solve in place from `estimate` and return the number of sums used.

        Parameters
        ----------
        estimate : array of `dtype`, shape (places,)
            Start and result in newtons, in block order (`blocks_of`); empty places are 0.
        sums_n, weights : arrays of `dtype`, shape (m,)
            Sums in newtons and their weights, 0 to 1; sums of weight 0 have no effect.
        relative_penalty : float
            λ of this solve / λ of the settings.

        Raises
        ------
        InputError
            If a dtype or shape does not fit, a weight is not 0 to 1, or a sum of weight above 0 is not a number up to
            1e6 newtons; the estimate is then unchanged.
        """
        check_estimate(estimate, self._taxel.shape, self.dtype)
        sums, counting = checked(sums_n, weights, (self.sums,), self.dtype)
        require_number("the relative penalty", relative_penalty)
        self._problem.numbers[1] = self._threshold * relative_penalty
        return int(self._kernel.solve(estimate, sums, counting, self._problem, self._scratch))

    def reset(self) -> None:
        """Reset the state besides the estimate."""
        self._dual[:] = 0

    def blocks_of(self, image: Values) -> Values:
        """Return an image of shape (rows, columns) in block order, shape (places,)."""
        check_values("image", image, self.shape)
        return self._phi.padded(image.reshape(-1))[self._taxel].astype(self.dtype, copy=False)

    def image_of(self, estimate: Values) -> Values:
        """Return block order, shape (places,), as an image of shape (rows, columns)."""
        check_values("estimate", estimate, self._taxel.shape)
        image = estimate[self._problem.deliver]
        image[self._is_gap] = 0
        return image.reshape(self.shape)

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return a new image of shape (rows, columns), negative forces as 0."""
        kept = placed("estimate", estimate, self._taxel.shape, self.dtype)
        image = np.empty(self.shape, np.float32)
        deliver(image.reshape(-1), kept, self._problem.deliver)
        if self._problem.gaps.size:
            image.reshape(-1)[self._is_gap] = 0
        return image
