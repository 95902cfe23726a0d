"""The field of forces that explains sums best, forces below zero included.

    x = argmin ½ |W (e - c - Φ x)|² + λ TV(x),   λ = 1.5 σ √(Φᵀ Φ),   σ = 1.48 median |e - c - Φ x|

e are sums less what the zero and noise explain, W their weights of 0 or 1, TV the total variation of neighbouring
taxels. λ is what the noise σ of the sums needs, so that noise alone, white offsets of taxels included, gives x = 0:
only what neighbouring taxels share is in x. A board's converter shifts all its taxels alike. Where these are spread
over the skin, the shift c of the board's total is a cheaper explanation than its taxels one by one.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from calibration.windows import Bools, Floats, rms
from reconstructor.kernels.blocks import places_of_sums, taxels_in_block_order
from reconstructor.kernels.transforms import hadamard
from reconstructor.kernels.variation import VariationSolver
from reconstructor.settings import VARIATION
from skin.phi import Sbhe
from skin.surface import Surface

#: λ in deviations of Φᵀ noise: of noise alone no taxel of the field is above a tenth of the noise of the picture.
PENALTY_RATIO: Final = 1.5
#: The field of noise alone stays below `SEEN_RATIO` deviations of the picture of the sums; 1.3 were the most seen.
SEEN_RATIO: Final = 3.0
#: Iterations between two looks at the noise, and with it at λ. The noise begins large, so that the field of a wide
#: touch appears at once, and the passes end when it falls by less than `SETTLED` of itself.
ITERATIONS: Final = 20
PASSES: Final = 10
SETTLED: Final = 0.05
#: While the noise falls to less than this part, most of it is a touch that is not explained yet: λ is halved.
FALLING: Final = 0.8
#: From pass to pass the noise, at first the root mean square of the sums, falls by this factor at most: a small λ
#: finds a small touch late.
STEEPEST: Final = 4.0
#: Standard deviation of normal numbers over the median of their sizes.
DEVIATION_OF_MEDIAN: Final = 1.4826
#: Cost of a newton of a board's shift in units of λ: more than that of a touched patch, less than that of its taxels.
SHIFT_COST: Final = 2.0
#: A board is spread over the skin if each of its taxels has on average `SPREAD_EDGES` edges to taxels of other boards.
SPREAD_EDGES: Final = 3.0


class Field(NamedTuple):
    """What explains sums.

    Attributes
    ----------
    force_n : array, shape (n,)
        Row-major, newtons; below 0 where the zero is too high.
    noise_n : float
        Standard deviation of what is not explained, newtons.
    shift_n : array, shape (m,)
        By which the totals of boards have shifted, newtons.
    """

    force_n: Floats
    noise_n: float
    shift_n: Floats


class FieldFinder:
    """Finds fields.

    Parameters
    ----------
    surface : Surface
        Of the skin.

    Attributes
    ----------
    phi : Sbhe
    """

    def __init__(self, phi: Sbhe, surface: Surface) -> None:
        settings = replace(VARIATION, iterations=ITERATIONS, penalty_n=1.0, nonnegative=False, scaled_start=False)
        self._solver = VariationSolver(phi, *surface.shape, settings, edges=surface.graph)
        self.phi, self._surface = phi, surface
        self._taxels, self._places = taxels_in_block_order(phi), places_of_sums(phi)
        #: Standard deviation of Φᵀ noise over that of the noise.
        self._gain = float(np.sqrt(phi.shape[0] / phi.blocks))
        #: Noise of Φᵀ sums / block size, the picture of the sums, over that of the sums.
        self.picture_gain: Final = self._gain / phi.block_size
        #: Sums of a skin where every force is 1.
        self._even = np.asarray(phi.forward(np.ones(phi.shape[1])), np.float64)
        self._shifts = (phi.row_of_sum == 0) & _is_spread(phi, surface)[phi.block_of_sum]

    def least_n(self, noise_n: float) -> float:
        """Return the force from which on a taxel of a field is more than noise, newtons."""
        return SEEN_RATIO * self.picture_gain * noise_n

    def sums(self, force_n: Floats) -> Floats:
        """Return Φ x, shape (m,), of a field x, shape (n,)."""
        work = self.phi.padded(force_n)[self._taxels]
        hadamard(work, self.phi.blocks)
        return work[self._places]

    def opened(self, taxels: Bools) -> Bools:
        """Return taxels, shape (n,), without those that are in no square of others; on no grid: not in their 2-core.

        The 2-core (Seidman 1983) is what is left when taxels with fewer than two neighbours go, again and again.
        """
        if self._surface.is_grid:
            field = taxels.reshape(self._surface.shape)
            squares = np.pad(field[:-1, :-1] & field[:-1, 1:] & field[1:, :-1] & field[1:, 1:], 1)
            return (squares[1:, 1:] | squares[1:, :-1] | squares[:-1, 1:] | squares[:-1, :-1]).ravel()
        edges, left = self._surface.edges, taxels
        while True:
            kept = np.bincount(edges[left[edges].all(axis=1)].ravel(), minlength=left.size) >= 2
            if kept.sum() == left.sum():
                return kept
            left = kept

    def find(self, sums_n: Floats, known: Bools, least_noise_n: float, *, is_sharp: bool = False) -> Field:
        """Return the field of sums.

        Parameters
        ----------
        sums_n : array, shape (m,)
            Newtons.
        known : array of bool, shape (m,)
            Other sums have no part in it.
        least_noise_n : float
            Standard deviation of `sums_n` by noise alone.
        is_sharp : bool
            All but this noise is in the field, however little neighbouring taxels share.
        """
        solver, shifts = self._solver, self._shifts & known
        solver.reset()
        estimate, force_n = solver.new_estimate(), np.zeros(self.phi.shape[1])
        weights, left_n, shift_n = known.astype(np.float32), sums_n, np.zeros_like(sums_n)
        noise_n, ratio = rms(sums_n[known & ~shifts]) * STEEPEST, PENALTY_RATIO
        for turn in range(PASSES):
            before_n, seen_n = noise_n, max(least_noise_n, 0.0 if is_sharp else _deviation(left_n[known]))
            noise_n = max(seen_n, before_n / STEEPEST)
            if turn > 1 and ratio == PENALTY_RATIO and noise_n == seen_n and noise_n > (1 - SETTLED) * before_n:
                break
            ratio = PENALTY_RATIO * (0.5 if turn > 0 and noise_n < FALLING * before_n else 1.0)
            penalty_n = ratio * noise_n * self._gain
            # At first without the totals that may be shifted; what their boards have in common is then the field's.
            weights[shifts] = turn > 0
            solver.solve(estimate, (sums_n - shift_n).astype(np.float32), weights, relative_penalty=penalty_n)
            force_n = solver.image_of(estimate).ravel().astype(np.float64)
            left_n = sums_n - self.sums(force_n)
            if turn == 0 and shifts.any():
                common_n = float(np.median(left_n[shifts] / self._even[shifts]))
                estimate[self._taxels < force_n.size] += np.float32(common_n)
                left_n -= common_n * self._even
            dear_n = SHIFT_COST * PENALTY_RATIO * seen_n * self._gain
            shift_n = np.where(shifts, left_n - np.clip(left_n, -dear_n, dear_n), 0.0)
            left_n = left_n - shift_n
        return Field(force_n, noise_n, shift_n)


def _deviation(values: Floats) -> float:
    return DEVIATION_OF_MEDIAN * float(np.median(np.abs(values))) if values.size else 0.0


def _is_spread(phi: Sbhe, surface: Surface) -> Bools:
    """Tell of each block whether its taxels are spread over the skin; shape (blocks,)."""
    low, high = phi.block_of_taxel[surface.edges].T
    ends = np.concatenate((low[low != high], high[low != high]))
    return np.asarray(np.bincount(ends, minlength=phi.blocks) >= SPREAD_EDGES * phi.block_size, np.bool_)
