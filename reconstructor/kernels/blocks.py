"""The compiled solvers of sums of blocks: tables and constants of one Φ and one prior, checks, working memory."""

from collections.abc import Callable
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import Values, check_estimate, check_grid_of, check_values, float_kind, placed
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
from reconstructor.kernels.graph import graph_of, in_runs
from reconstructor.kernels.steps import Problem, Step, Table, aligned, deliver, memory_of, usable
from reconstructor.settings import SolverSettings
from skin.phi import Sbhe
from skin.ranges import require_number

#: The order of pixels of a prior; of all others row by row.
ADDRESSES: Final[dict[str, Callable[[int, int], Indices]]] = {
    "haar-pyramid": pyramid_addresses,
    "haar-tensor": tensor_addresses,
}


def make_problem(  # noqa: PLR0917
    phi: Sbhe, rows: int, columns: int, settings: SolverSettings, kind: np.dtype[Any], edges: Indices | None = None
) -> Problem:
    """Return the tables and constants of a solver; for `edges` see `BlockSolver`."""
    check_grid_of(phi, rows, columns, settings.prior, edges)
    taxel = taxels_in_block_order(phi)
    addresses = ADDRESSES.get(settings.prior, row_addresses)(rows, columns)
    if edges is not None:
        rank = in_runs(edges, rows * columns)
        addresses, edges = rank.reshape(rows, columns), rank[edges]
    shifts = spin_shifts(settings.spins, rows, columns)
    gaps = addresses.ravel()[~phi.is_wired]
    # What empty places take from the image is 0: a gap, or what follows the image.
    none = np.full(phi.empty, gaps[0] if gaps.size else rows * columns)
    to_blocks = [np.append(shifted(addresses, shift).ravel(), none)[taxel] for shift in shifts]
    to_image = [_inverse(each, taxel < rows * columns, rows * columns) for each in to_blocks]
    return Problem(
        places=places_of_sums(phi),
        to_image=np.array(to_image, np.uint16),
        to_blocks=np.array(to_blocks, np.uint16),
        deliver=_inverse(taxel, taxel < rows * columns, rows * columns).astype(np.uint16),
        gaps=gaps.astype(np.uint16),
        graph=graph_of(rows, columns, gaps, edges),
        momentum=momentum(settings.iterations).astype(kind),
        blocks=phi.blocks,
        rows=rows,
        columns=columns,
        levels=pyramid_levels(rows, columns) if settings.prior.endswith("pyramid") else 0,
        scaled_start=settings.scaled_start,
    )


def _inverse(of_places: Indices, held: npt.NDArray[np.bool_], size: int) -> Indices:
    """Return the place of each of `size` pixels; 0 for a pixel without one."""
    found = np.zeros(size, np.intp)
    found[of_places[held]] = np.flatnonzero(held)
    return found


def taxels_in_block_order(phi: Sbhe) -> Indices:
    """Return the taxel at each place of block order, shape (places,): by place in the block, then by block."""
    return phi.order.reshape(phi.blocks, phi.block_size).T.ravel()


def places_of_sums(phi: Sbhe) -> Table:
    """Return the place of every sum in block order, shape (m,)."""
    return (phi.row_of_sum * phi.blocks + phi.block_of_sum).astype(np.uint16)


def checked(sums_n: Values, weights: Values, shape: tuple[int, ...], kind: np.dtype[Any]) -> tuple[Values, Values]:
    """Check the sums and weights of one cycle, and return them for the compiled solvers."""
    sums, counting = placed("sums", sums_n, shape, kind), placed("weights", weights, shape, kind)
    if not usable(sums.reshape(-1), counting.reshape(-1)):
        raise InputError("expected weights of 0 to 1, and sums of at most 1e6 N where the weight is not 0")
    return sums, counting


class BlockSolver:
    """min ½ Σ w (Φx - y)² + λ R(x) by FISTA, Φ an SBHE, compiled as a whole, for one thread and without allocation.

    The iteration is over the image, not over coefficients. For an orthonormal Ψ both iterations are the same, and
    shifts of the basis and non-negativity need no extra time.

    Parameters
    ----------
    phi : Sbhe
        Any block size.
    rows, columns : int
        1 to 256; for a wavelet powers of two from 8.
    settings : SolverSettings
        With one of `priors`.
    edges : array of int, shape (edges, 2), optional
        Pairs of neighbours of a skin that is no grid (`skin.surface.Surface.graph`); for total variation.

    Attributes
    ----------
    priors : tuple of str
        R: those of the class.
    """

    priors: ClassVar[tuple[str, ...]]
    #: The compiled function.
    iterate: ClassVar[Callable[..., int]]

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
        kind = self.dtype = float_kind(dtype)
        if settings.prior not in self.priors:
            raise InputError(f"expected one of {', '.join(self.priors)}, got '{settings.prior}'")
        self._problem = make_problem(phi, rows, columns, settings, kind, edges)
        self._phi = phi
        self.shape: Final = (rows, columns)
        self.sums: Final = phi.shape[0]
        self._taxel = taxels_in_block_order(phi)
        size = 1 / (settings.lipschitz_ratio * phi.block_size)
        self._threshold = settings.penalty_n * size
        floor = 0 if settings.nonnegative else np.finfo(kind).min
        self._size, self._floor, self._number = kind.type(size), kind.type(floor), kind.type
        dual = self._problem.graph.size
        self._memory = memory_of(self._taxel.size, phi.taxels, dual, kind)
        self._dual = self._memory[self._memory.size - dual :]
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
        step = Step(self._size, self._number(self._threshold * relative_penalty), self._floor)
        return int(type(self).iterate(estimate, sums, counting, self._problem, step, self._memory))

    def reset(self) -> None:
        """Clear the dual variable."""
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
