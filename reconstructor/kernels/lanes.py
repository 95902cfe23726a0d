"""FISTA for SBHE and wavelets, several independent problems of one Φ side by side.

Taxel k of problem l is at ``k * LANES + l``. So the transforms of the single solver process all problems unchanged, and
a permutation moves whole vectors, not single values.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import Values, check_estimate, placed
from reconstructor.kernels import daubechies, haar
from reconstructor.kernels.problem import Model, checked
from reconstructor.kernels.steps import Problem, Table, advance, aligned, descend, row, scratch_of, start_scale
from reconstructor.kernels.transforms import FAST_MATH, Flat, hadamard
from reconstructor.settings import COMPILED_WAVELETS, SolverSettings
from skin.compiled import njit
from skin.measurement import Sbhe

#: Problems at once: eight of float32 are one vector, and the working memory stays in the L2 cache.
LANES: Final = 8
#: Rows of working memory: gain, target, ahead, work, image, other.
_SCRATCH_ROWS: Final = 6


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _solve(  # noqa: PLR0917  compiled functions take no keywords
    estimate: Flat, sums: Values, weights: Values, problem: Problem, scratch: Flat, smooth: bool
) -> None:
    """Solve in place from the estimates, with D4 if `smooth`, else with Haar."""
    size = estimate.size
    gain, target, ahead = row(scratch, 0, size), row(scratch, 1, size), row(scratch, 2, size)
    work, image, other = row(scratch, 3, size), row(scratch, 4, size), row(scratch, 5, size)
    threshold, floor, root_half, taps = (
        problem.numbers[1],
        problem.numbers[2],
        problem.numbers[3],
        problem.numbers[4:8],
    )
    _load(sums, weights, problem, gain, target)
    if problem.scaled_start:
        _scale_starts(estimate, gain, target, work, problem.blocks)
    ahead[:] = estimate
    work[:] = estimate
    for turn in range(problem.momentum.size):
        shift = turn % problem.tables.shape[1]
        descend(size, problem, scratch)
        _gather(image, work, problem.tables[0, shift])
        if smooth and problem.levels:
            daubechies.shrink_pyramid(image, other, problem, LANES, threshold, taps)
        elif smooth:
            daubechies.shrink_tensor(image, other, problem, LANES, threshold, taps)
        elif problem.levels:
            haar.shrink_pyramid(image, problem.levels, threshold, root_half * root_half)
        else:
            haar.shrink_tensor(image, problem.columns, LANES, threshold, root_half)
        _gather(work, image, problem.tables[1, shift])
        advance(estimate, floor, problem.momentum[turn], scratch)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _load(sums: Values, weights: Values, problem: Problem, gain: Flat, target: Flat) -> None:
    """Write the masks and the masked sums, both over L; see `reconstructor.kernels.steps.load`."""
    for k in range(problem.places.size):
        start = int(problem.places[k]) * LANES
        for lane in range(LANES):
            weight = problem.numbers[0] * weights[lane, k]
            gain[start + lane] = weight
            target[start + lane] = weight * sums[lane, k] if weight > 0 else weight


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _scale_starts(estimate: Flat, gain: Flat, target: Flat, work: Flat, blocks: int) -> None:
    """Scale the start of every lane; see `reconstructor.kernels.steps.begin`."""
    work[:] = estimate
    hadamard(work, blocks)
    explained = np.zeros(LANES, estimate.dtype)
    energy = np.zeros(LANES, estimate.dtype)
    for start in range(0, work.size, LANES):
        for lane in range(LANES):
            seen = gain[start + lane] * work[start + lane]
            explained[lane] += seen * target[start + lane]
            energy[lane] += seen * seen
    for lane in range(LANES):
        explained[lane] = start_scale(explained[lane], energy[lane])
    for start in range(0, work.size, LANES):
        for lane in range(LANES):
            estimate[start + lane] *= explained[lane]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _gather(target: Flat, source: Flat, index: Table) -> None:
    """Move eight values at a time: all are read before any is written, so that they become one vector."""
    for k in range(index.size):
        there = target[k * LANES : (k + 1) * LANES]
        taken = source[int(index[k]) * LANES : (int(index[k]) + 1) * LANES]
        a, b, c, d, e, f, g, h = taken[0], taken[1], taken[2], taken[3], taken[4], taken[5], taken[6], taken[7]
        there[0], there[1], there[2], there[3], there[4], there[5], there[6], there[7] = a, b, c, d, e, f, g, h


class LaneSolver:
    """`FusedSolver` for `LANES` streams of one Φ: skins of one layout, or parts of a recording.

    Parameters
    ----------
    phi, rows, columns, dtype
        See `reconstructor.kernels.fused.FusedSolver`.
    settings : SolverSettings
        A prior of `COMPILED_WAVELETS`. Total variation has no such solver: its loops are vectorised already, and eight
        duals would not fit the cache.

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
        settings: SolverSettings,
        *,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        if settings.prior not in COMPILED_WAVELETS:
            expected = ", ".join(COMPILED_WAVELETS)
            raise InputError(f"'{settings.prior}' has no solver in lanes: expected one of {expected}")
        model = Model(phi, rows, columns, settings, dtype)
        self.shape: Final = (rows, columns)
        self.dtype: Final = np.dtype(dtype)
        self.sums: Final = phi.shape[0]
        self._problem = model.problem(LANES)
        self._smooth = settings.prior.startswith("d4")
        self._scratch = scratch_of(_SCRATCH_ROWS, phi.order.size * LANES, self.dtype)

    def new_estimate(self) -> Values:
        """Return estimates of zeros, shape (n · LANES,)."""
        return aligned(self.shape[0] * self.shape[1] * LANES, self.dtype)

    def solve(self, estimate: Values, sums_n: Values, weights: Values) -> None:
        """Solve in place from the estimates.

        Parameters
        ----------
        estimate : array of `dtype`, shape (n · LANES,)
        sums_n, weights : arrays of `dtype`, shape (LANES, m)
            See `reconstructor.kernels.fused.FusedSolver.solve`.

        Raises
        ------
        InputError
            As there.
        """
        check_estimate(estimate, (self.shape[0] * self.shape[1] * LANES,), self.dtype)
        sums, counting = checked(sums_n, weights, (LANES, self.sums), self.dtype)
        _solve(estimate, sums, counting, self._problem, self._scratch, self._smooth)

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return new images, shape (LANES, rows, columns), negative forces as 0."""
        kept = placed("estimate", estimate, (self.shape[0] * self.shape[1] * LANES,), self.dtype)
        streams = kept.reshape(-1, LANES)[self._problem.deliver]
        return np.maximum(streams.T, 0).astype(np.float32).reshape(LANES, *self.shape)
