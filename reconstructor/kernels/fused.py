"""The compiled solver for one Φ and one Haar basis."""

import math
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from reconstructor.bases.basis import check_grid
from reconstructor.fista import momentum
from reconstructor.kernels.addresses import (
    pyramid_addresses,
    pyramid_levels,
    shifted,
    spin_shifts,
    tensor_addresses,
)
from reconstructor.kernels.solve import Problem, Scratch, solve
from skin.errors import InputError
from skin.measurement import Sbhe

HaarForm = Literal["pyramid", "tensor"]
Values = npt.NDArray[np.floating[Any]]


class FusedHaar:
    """min ½‖Φx - y‖² + λ‖Ψᵀx‖₁ by FISTA, Φ an SBHE and Ψ Haar, on one thread and without allocation.

    The state is the image itself in place of its coefficients, which for an orthonormal Ψ is the same iteration and
    lets shifts of the basis and non-negativity into it for nothing. Equal to `reconstructor.fista.fista_image`.

    Parameters
    ----------
    phi : Sbhe
        Any block size.
    rows, columns : int
        Powers of two, 8 to 256, not necessarily equal.
    iterations : int
        How many, each solve.
    penalty_n : float
        λ, newtons.
    lipschitz_ratio : float
        L / B. ΦᵀΦ has no eigenvalue above B, so 1 is exact; the paper takes 2.
    basis : {"pyramid", "tensor"}
    spins : int
        The basis moves on through this many shifts from iteration to iteration (cycle spinning); 1 keeps it fixed.
    nonnegative : bool
        Lift negative taxels to 0 in every iteration.
    matched : bool
        First scale each start by max(0, 2a - 1), where a is the factor, at most 1, that explains the sums best.
    dtype : float32 or float64

    Raises
    ------
    InputError
        If the grid is not one of Φ's taxels or not of powers of two, or a number is out of its range.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        *,
        iterations: int,
        penalty_n: float,
        lipschitz_ratio: float = 1.0,
        basis: HaarForm = "pyramid",
        spins: int = 1,
        nonnegative: bool = False,
        matched: bool = False,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        _check_grid(phi, rows, columns)
        _check_settings(iterations, penalty_n, lipschitz_ratio)
        _check_basis(basis, spins, most=min(8, rows) * min(8, columns))
        self.shape: Final = (rows, columns)
        self.shifts: Final = spin_shifts(spins, rows, columns)
        self.dtype: Final = np.dtype(dtype)
        step = 1 / (lipschitz_ratio * phi.block_size)
        floor = 0.0 if nonnegative else float(np.finfo(self.dtype).min)
        addresses = (pyramid_addresses if basis == "pyramid" else tensor_addresses)(rows, columns)
        # Block order has the rows of W outside, so that one butterfly runs over all blocks.
        self._taxel = phi.order.reshape(phi.blocks, phi.block_size).T.ravel()
        self._place = np.argsort(self._taxel)
        to_blocks = np.stack([shifted(addresses, shift).ravel()[self._taxel] for shift in self.shifts])
        places = phi.row_of_sum * phi.blocks + phi.block_of_sum
        self._problem = Problem(
            sums=places.astype(np.uint16),
            to_image=np.argsort(to_blocks, axis=1).astype(np.uint16),
            to_blocks=to_blocks.astype(np.uint16),
            scalars=np.array((step, penalty_n * step, 0.5**0.5, floor), self.dtype),
            momentum=momentum(iterations).astype(self.dtype),
            blocks=phi.blocks,
            columns=columns,
            levels=pyramid_levels(rows, columns) if basis == "pyramid" else 0,
            matched=matched,
        )
        self._scratch = Scratch(*np.zeros((len(Scratch._fields), phi.order.size), self.dtype))

    def solve(self, estimate: Values, sums_n: Values, valid_sums: npt.NDArray[np.bool_]) -> int:
        """Improve `estimate` in place and return how many sums were valid.

        Parameters
        ----------
        estimate : array of `dtype`, shape (n,)
            Start and result in newtons, in block order (`blocks_of`).
        sums_n, valid_sums : arrays of `dtype` and bool, shape (m,)
            Sums that are not valid are left out exactly.
        """
        return int(solve(estimate, sums_n, valid_sums, self._problem, self._scratch))

    def blocks_of(self, image: Values) -> Values:
        """Return an image of shape (rows, columns) in block order, shape (n,)."""
        return image.reshape(-1)[self._taxel].astype(self.dtype, copy=False)

    def image_of(self, estimate: Values) -> Values:
        """Return block order, shape (n,), as an image of shape (rows, columns)."""
        return estimate[self._place].reshape(self.shape)


def _check_grid(phi: Sbhe, rows: int, columns: int) -> None:
    count = phi.order.size
    if rows * columns != count:
        raise InputError(f"Φ measures {count} taxels but the grid has {rows} x {columns} = {rows * columns}")
    check_grid(rows, columns)


def _check_settings(iterations: int, penalty_n: float, lipschitz_ratio: float) -> None:
    if iterations < 1:
        raise InputError(f"expected at least 1 iteration, got {iterations}")
    if not 0 <= penalty_n < math.inf:
        raise InputError(f"expected a penalty λ of 0 newtons or more, got {penalty_n}")
    if not 1 <= lipschitz_ratio < math.inf:
        raise InputError(f"expected L / B of 1 or more, below which FISTA diverges: got {lipschitz_ratio}")


def _check_basis(basis: str, spins: int, most: int) -> None:
    if basis not in get_args(HaarForm):
        raise InputError(f"unknown basis '{basis}': expected one of {', '.join(get_args(HaarForm))}")
    if not 1 <= spins <= most:
        raise InputError(f"expected 1 to {most} shifts of the basis, got {spins}")
