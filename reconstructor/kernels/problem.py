"""The tables and numbers of one Φ and one prior, for solvers of a single image and of many side by side."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from reconstructor.bases.separable import DAUBECHIES_4
from reconstructor.checks import check_grid_of, check_settings, float_kind, placed
from reconstructor.fista import momentum
from reconstructor.kernels.addresses import (
    Indices,
    pyramid_addresses,
    pyramid_levels,
    row_addresses,
    shifted,
    spin_shifts,
    tensor_addresses,
)
from reconstructor.kernels.steps import Problem, Table, usable
from skin.errors import InputError
from skin.measurement import Sbhe

Prior = Literal["haar-pyramid", "haar-tensor", "d4-pyramid", "d4-tensor", "variation"]
Values = npt.NDArray[np.floating[Any]]

ADDRESSES: Final[dict[str, Callable[[int, int], Indices]]] = {
    "haar-pyramid": pyramid_addresses,
    "haar-tensor": tensor_addresses,
    "d4-pyramid": row_addresses,
    "d4-tensor": row_addresses,
    "variation": row_addresses,
}


@dataclass(frozen=True)
class Model:
    """What a compiled solver minimises and how; see `reconstructor.kernels.fused.FusedSolver` for each option."""

    phi: Sbhe
    rows: int
    columns: int
    prior: Prior
    iterations: int
    penalty_n: float
    lipschitz_ratio: float
    spins: int
    nonnegative: bool
    matched: bool
    dtype: npt.DTypeLike

    def __post_init__(self) -> None:
        """Refuse what does not fit."""
        check_grid_of(self.phi, self.rows, self.columns)
        check_settings(self.iterations, self.penalty_n, self.lipschitz_ratio)
        if self.prior not in ADDRESSES:
            raise InputError(f"unknown prior '{self.prior}': expected one of {', '.join(get_args(Prior))}")
        if self.prior == "variation" and self.spins != 1:
            raise InputError(f"total variation has no basis to shift: expected spins of 1, got {self.spins}")
        most = min(8, self.rows) * min(8, self.columns)
        if not 1 <= self.spins <= most:
            raise InputError(f"expected 1 to {most} shifts of the basis, got {self.spins}")
        float_kind(self.dtype)

    @property
    def step(self) -> float:
        """1 / L."""
        return 1 / (self.lipschitz_ratio * self.phi.block_size)

    def problem(self, lanes: int = 1) -> Problem:
        """Return the tables for `lanes` images side by side."""
        kind, phi, taxel = np.dtype(self.dtype), self.phi, taxels_in_block_order(self.phi)
        floor = 0.0 if self.nonnegative else float(np.finfo(kind).min)
        addresses = ADDRESSES[self.prior](self.rows, self.columns)
        shifts = spin_shifts(self.spins, self.rows, self.columns)
        to_blocks = np.stack([shifted(addresses, shift).ravel()[taxel] for shift in shifts])
        return Problem(
            places=places_of_sums(phi),
            tables=np.stack((np.argsort(to_blocks, axis=1), to_blocks)).astype(np.uint16),
            deliver=np.argsort(taxel).astype(np.uint16),
            numbers=np.array((self.step, self.penalty_n * self.step, floor, 0.5**0.5, *DAUBECHIES_4), kind),
            momentum=momentum(self.iterations).astype(kind),
            blocks=phi.blocks * lanes,
            rows=self.rows,
            columns=self.columns,
            levels=pyramid_levels(self.rows, self.columns) if self.prior.endswith("pyramid") else 0,
            matched=self.matched,
        )


def taxels_in_block_order(phi: Sbhe) -> Indices:
    """Return the taxel at each place, shape (n,): the rows of W outside, so that one butterfly runs over all blocks."""
    return phi.order.reshape(phi.blocks, phi.block_size).T.ravel()


def places_of_sums(phi: Sbhe) -> Table:
    """Return the place of every sum in block order, shape (m,)."""
    return (phi.row_of_sum * phi.blocks + phi.block_of_sum).astype(np.uint16)


def check_penalty_ratio(relative_penalty: float) -> None:
    """Raise InputError unless λ can be scaled so."""
    if not 0 <= relative_penalty < math.inf:
        raise InputError(f"expected a relative penalty of 0 or more, got {relative_penalty}")


def checked(sums_n: Values, weights: Values, shape: tuple[int, ...], kind: np.dtype[Any]) -> tuple[Values, Values]:
    """Return the sums and weights of one cycle as compiled solvers read them.

    Raises
    ------
    InputError
        If they are of another shape or dtype, a weight is not 0 to 1, or a sum that counts is not finite or too large.
    """
    sums, counting = placed("sums", sums_n, shape, kind), placed("weights", weights, shape, kind)
    if not usable(sums.reshape(-1), counting.reshape(-1)):
        raise InputError("expected weights of 0 to 1, and finite newtons below 1e6 where they are not 0")
    return sums, counting
