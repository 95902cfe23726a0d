"""FISTA for SBHE and the Haar pyramid, several independent problems of one Φ side by side.

Taxel k of problem l stands at ``k * LANES + l``. Transforms of the single kernel then run over all problems as they
are, and a permutation moves whole vectors instead of single values.
"""

from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

from reconstructor.fista import momentum
from reconstructor.kernels.addresses import pyramid_addresses, pyramid_levels, shifted, spin_shifts
from reconstructor.kernels.fused import check_grid_of, check_settings
from reconstructor.kernels.haar import shrink_pyramid
from reconstructor.kernels.steps import Problem, advance, aligned, descend, row, scratch_of
from reconstructor.kernels.transforms import FAST_MATH, Flat
from skin.measurement import Sbhe

Values = npt.NDArray[np.floating[Any]]
Table = npt.NDArray[np.uint16]
#: Problems at once: eight of float32 are one vector, and the working memory stays in the L2 cache.
LANES: Final = 8
_SCRATCH_ROWS: Final = 5


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _solve(estimate: Flat, sums: Values, weights: Values, problem: Problem, scratch: Flat) -> None:
    size = estimate.size
    gain, target, ahead = row(scratch, 0, size), row(scratch, 1, size), row(scratch, 2, size)
    work, image = row(scratch, 3, size), row(scratch, 4, size)
    step, threshold, floor, root_half = problem.numbers[0], problem.numbers[1], problem.numbers[2], problem.numbers[3]
    for k in range(problem.places.size):
        start = int(problem.places[k]) * LANES
        for lane in range(LANES):
            weight = step * weights[lane, k]
            gain[start + lane] = weight
            target[start + lane] = weight * sums[lane, k] if weight > 0 else weight
    ahead[:] = estimate
    work[:] = estimate
    for turn in range(problem.momentum.size):
        shift = turn % problem.tables.shape[1]
        descend(size, problem, scratch)
        _gather(image, work, problem.tables[0, shift])
        shrink_pyramid(image, problem.levels, threshold, root_half * root_half)
        _gather(work, image, problem.tables[1, shift])
        advance(estimate, floor, problem.momentum[turn], scratch)


@numba.njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _gather(target: Flat, source: Flat, index: Table) -> None:
    """Move eight values at a time: all are read before any is written, so that they become one vector."""
    for k in range(index.size):
        there = target[k * LANES : (k + 1) * LANES]
        taken = source[int(index[k]) * LANES : (int(index[k]) + 1) * LANES]
        a, b, c, d, e, f, g, h = taken[0], taken[1], taken[2], taken[3], taken[4], taken[5], taken[6], taken[7]
        there[0], there[1], there[2], there[3], there[4], there[5], there[6], there[7] = a, b, c, d, e, f, g, h


class LaneSolver:
    """`FusedSolver` with the Haar pyramid for `LANES` streams of one Φ: skins of one layout, or parts of a recording.

    Parameters
    ----------
    phi, rows, columns, iterations, penalty_n, lipschitz_ratio, spins, nonnegative, dtype
        See `reconstructor.kernels.fused.FusedSolver`.

    Raises
    ------
    InputError
        As there.
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
        spins: int = 1,
        nonnegative: bool = False,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        check_grid_of(phi, rows, columns)
        check_settings(iterations, penalty_n, lipschitz_ratio)
        self.shape: Final = (rows, columns)
        self.dtype: Final = np.dtype(dtype)
        self.sums: Final = phi.shape[0]
        step = 1 / (lipschitz_ratio * phi.block_size)
        taxel = phi.order.reshape(phi.blocks, phi.block_size).T.ravel()
        addresses = pyramid_addresses(rows, columns)
        to_blocks = np.stack([shifted(addresses, each).ravel()[taxel] for each in spin_shifts(spins, rows, columns)])
        floor = 0.0 if nonnegative else float(np.finfo(self.dtype).min)
        self._problem = Problem(
            places=(phi.row_of_sum * phi.blocks + phi.block_of_sum).astype(np.uint16),
            tables=np.stack((np.argsort(to_blocks, axis=1), to_blocks)).astype(np.uint16),
            deliver=np.argsort(taxel).astype(np.uint16),
            numbers=np.array((step, penalty_n * step, floor, 0.5**0.5), self.dtype),
            momentum=momentum(iterations).astype(self.dtype),
            blocks=phi.blocks * LANES,
            rows=rows,
            columns=columns,
            levels=pyramid_levels(rows, columns),
            matched=False,
        )
        self._scratch = scratch_of(_SCRATCH_ROWS, taxel.size * LANES, self.dtype)

    def new_estimate(self) -> Values:
        """Return estimates of zeros, shape (n · LANES,)."""
        return aligned(self.shape[0] * self.shape[1] * LANES, self.dtype)

    def solve(self, estimate: Values, sums_n: Values, weights: Values) -> None:
        """Improve the estimates in place; `sums_n` and `weights` of shape (LANES, m) and the solver's dtype."""
        _solve(estimate, sums_n, weights, self._problem, self._scratch)

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return new images, shape (LANES, rows, columns), negative forces as 0."""
        streams = estimate.reshape(-1, LANES)[self._problem.deliver]
        return np.maximum(streams.T, 0).astype(np.float32).reshape(LANES, *self.shape)
