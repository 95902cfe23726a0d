"""The compiled solver for one Φ and one prior."""

import math
from collections.abc import Callable
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from reconstructor.bases.basis import check_grid
from reconstructor.bases.separable import DAUBECHIES_4
from reconstructor.fista import momentum
from reconstructor.kernels import daubechies, haar, variation
from reconstructor.kernels.addresses import (
    Indices,
    pyramid_addresses,
    pyramid_levels,
    row_addresses,
    shifted,
    spin_shifts,
    tensor_addresses,
)
from reconstructor.kernels.steps import Problem, aligned, deliver, row, scratch_of
from skin.errors import InputError
from skin.measurement import Sbhe

Prior = Literal["haar-pyramid", "haar-tensor", "d4-pyramid", "d4-tensor", "variation"]
Values = npt.NDArray[np.floating[Any]]


class _Kernel(NamedTuple):
    """One compiled solver: its entry, the order of its image, its working memory, and which rows of it are state."""

    solve: Callable[..., int]
    addresses: Callable[[int, int], Indices]
    scratch_rows: int
    state: tuple[int, ...] = ()


_KERNELS: Final[dict[str, _Kernel]] = {
    "haar-pyramid": _Kernel(haar.solve_haar, pyramid_addresses, haar.SCRATCH_ROWS),
    "haar-tensor": _Kernel(haar.solve_haar, tensor_addresses, haar.SCRATCH_ROWS),
    "d4-pyramid": _Kernel(daubechies.solve_daubechies, row_addresses, daubechies.SCRATCH_ROWS),
    "d4-tensor": _Kernel(daubechies.solve_daubechies, row_addresses, daubechies.SCRATCH_ROWS),
    "variation": _Kernel(variation.solve_variation, row_addresses, variation.SCRATCH_ROWS, variation.DUAL_ROWS),
}


class FusedSolver:
    """min ½‖Φx - y‖² + λ R(x) by FISTA, Φ an SBHE, on one thread and without allocation.

    R is ‖Ψᵀx‖₁ of an orthonormal wavelet or the anisotropic total variation. The state is the image itself in place
    of its coefficients, which for an orthonormal Ψ is the same iteration and lets shifts of the basis and
    non-negativity into it for nothing. Equal to `reconstructor.fista.fista_image`.

    Parameters
    ----------
    phi : Sbhe
        Any block size.
    rows, columns : int
        Powers of two, 8 to 256, not necessarily equal.
    prior : {"haar-pyramid", "haar-tensor", "d4-pyramid", "d4-tensor", "variation"}
    iterations : int
        How many, each solve.
    penalty_n : float
        λ, newtons.
    lipschitz_ratio : float
        L / B. ΦᵀΦ has no eigenvalue above B, so 1 is exact; the paper takes 2.
    spins : int
        The basis moves on through this many shifts from iteration to iteration (cycle spinning); 1 keeps it fixed.
        Total variation has no grid to move: 1.
    nonnegative : bool
        Lift negative taxels to 0 in every iteration.
    matched : bool
        First scale each start by max(0, 2a - 1), where a is the factor, at most 1, that explains the sums best.
    dtype : float32 or float64

    Raises
    ------
    InputError
        If the grid is not one of Φ's taxels or not of powers of two, or an option is out of its range.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        *,
        prior: Prior,
        iterations: int,
        penalty_n: float,
        lipschitz_ratio: float = 1.0,
        spins: int = 1,
        nonnegative: bool = False,
        matched: bool = False,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        check_grid_of(phi, rows, columns)
        check_settings(iterations, penalty_n, lipschitz_ratio)
        _check_prior(prior, spins, most=min(8, rows) * min(8, columns))
        self.shape: Final = (rows, columns)
        self.shifts: Final = spin_shifts(spins, rows, columns)
        self.dtype: Final = np.dtype(dtype)
        if self.dtype not in {np.dtype(np.float32), np.dtype(np.float64)}:
            raise InputError(f"expected float32 or float64, got {self.dtype}")
        self._kernel = _KERNELS[prior]
        step = 1 / (lipschitz_ratio * phi.block_size)
        floor = 0.0 if nonnegative else float(np.finfo(self.dtype).min)
        # Block order has the rows of W outside, so that one butterfly runs over all blocks.
        self._taxel = phi.order.reshape(phi.blocks, phi.block_size).T.ravel()
        self._problem = Problem(
            places=(phi.row_of_sum * phi.blocks + phi.block_of_sum).astype(np.uint16),
            tables=_tables(self._kernel.addresses(rows, columns), self.shifts, self._taxel),
            deliver=np.argsort(self._taxel).astype(np.uint16),
            numbers=np.array((step, penalty_n * step, floor, 0.5**0.5, *DAUBECHIES_4), self.dtype),
            momentum=momentum(iterations).astype(self.dtype),
            blocks=phi.blocks,
            rows=rows,
            columns=columns,
            levels=pyramid_levels(rows, columns) if prior.endswith("pyramid") else 0,
            matched=matched,
        )
        self._threshold = penalty_n * step
        self._scratch = scratch_of(self._kernel.scratch_rows, phi.order.size, self.dtype)

    def new_estimate(self) -> Values:
        """Return an estimate of zeros, shape (n,), placed where the kernels read it fastest."""
        return aligned(self._taxel.size, self.dtype)

    def solve(self, estimate: Values, sums_n: Values, weights: Values, *, relative_penalty: float = 1.0) -> int:
        """Improve `estimate` in place and return how many sums count.

        Parameters
        ----------
        estimate : array of `dtype`, shape (n,)
            Start and result in newtons, in block order (`blocks_of`).
        sums_n, weights : arrays of `dtype`, shape (m,)
            Newtons, and how much each sum counts, 0 to 1; sums of weight 0 are left out exactly.
        relative_penalty : float
            λ of this solve over the λ of the constructor.
        """
        self._problem.numbers[1] = self._threshold * relative_penalty
        return int(self._kernel.solve(estimate, sums_n, weights, self._problem, self._scratch))

    def reset(self) -> None:
        """Forget what is kept from solve to solve besides the estimate."""
        for number in self._kernel.state:
            row(self._scratch, number, self._taxel.size)[:] = 0

    def blocks_of(self, image: Values) -> Values:
        """Return an image of shape (rows, columns) in block order, shape (n,)."""
        return image.reshape(-1)[self._taxel].astype(self.dtype, copy=False)

    def image_of(self, estimate: Values) -> Values:
        """Return block order, shape (n,), as an image of shape (rows, columns)."""
        return estimate[self._problem.deliver].reshape(self.shape)

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return a new image of shape (rows, columns), negative forces as 0."""
        image = np.empty(self.shape, np.float32)
        deliver(image.reshape(-1), estimate, self._problem.deliver)
        return image


def _tables(addresses: Indices, shifts: list[tuple[int, int]], taxel: Indices) -> npt.NDArray[np.uint16]:
    """Return image order from block order and back, shape (2, shifts, n)."""
    to_blocks = np.stack([shifted(addresses, shift).ravel()[taxel] for shift in shifts])
    return np.stack((np.argsort(to_blocks, axis=1), to_blocks)).astype(np.uint16)


def check_grid_of(phi: Sbhe, rows: int, columns: int) -> None:
    """Raise InputError unless the grid is that of Φ's taxels and its sides are powers of two."""
    count = phi.order.size
    if rows * columns != count:
        raise InputError(f"Φ measures {count} taxels but the grid has {rows} x {columns} = {rows * columns}")
    check_grid(rows, columns)


def check_settings(iterations: int, penalty_n: float, lipschitz_ratio: float) -> None:
    """Raise InputError unless FISTA can run with these."""
    if iterations < 1:
        raise InputError(f"expected at least 1 iteration, got {iterations}")
    if not 0 <= penalty_n < math.inf:
        raise InputError(f"expected a penalty λ of 0 newtons or more, got {penalty_n}")
    if not 1 <= lipschitz_ratio < math.inf:
        raise InputError(f"expected L / B of 1 or more, below which FISTA diverges: got {lipschitz_ratio}")


def _check_prior(prior: str, spins: int, most: int) -> None:
    if prior not in _KERNELS:
        raise InputError(f"unknown prior '{prior}': expected one of {', '.join(get_args(Prior))}")
    if prior == "variation" and spins != 1:
        raise InputError(f"total variation has no basis to shift: expected spins of 1, got {spins}")
    if not 1 <= spins <= most:
        raise InputError(f"expected 1 to {most} shifts of the basis, got {spins}")
