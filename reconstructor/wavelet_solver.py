"""`reconstructor.fista.iterate` for sums of blocks and the coefficients of any orthogonal wavelet, in NumPy.

An iteration is that of `reconstructor.kernels.haar`, which is compiled. Hadamard blocks are applied as a dense matrix.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from reconstructor.bases import wavelet_basis
from reconstructor.checks import Values, check_estimate, check_grid_of, float_kind, placed
from reconstructor.fista import iterate, momentum, soft
from reconstructor.kernels.addresses import spin_shifts
from reconstructor.kernels.blocks import checked
from reconstructor.settings import SolverSettings
from skin.phi import Sbhe, fast_hadamard
from skin.ranges import require_number


class WaveletSolver:
    """min ½ Σ w (Φx - y)² + λ ‖Ψᵀx‖₁ by FISTA, Ψ any orthogonal wavelet; an estimate is the image.

    Parameters
    ----------
    phi : Sbhe
        Without empty places.
    rows, columns : int
        Powers of two from 8 to 256.
    settings : SolverSettings
        With the full name of a wavelet basis as its prior.
    edges : array of int, shape (edges, 2), optional
        Refused: a basis needs a grid.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        settings: SolverSettings,
        *,
        edges: npt.NDArray[np.intp] | None = None,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        check_grid_of(phi, rows, columns, settings.prior, edges)
        self.dtype: Final = float_kind(dtype)
        self.sums: Final = phi.shape[0]
        self.shape: Final = (rows, columns)
        self._settings, self._kept = settings, phi.kept
        self._order, self._place = phi.order, np.argsort(phi.order)
        self._hadamard = np.asarray(fast_hadamard(np.eye(phi.block_size)), self.dtype)
        self._psi = wavelet_basis(settings.prior, rows, columns, self.dtype)
        self._step = 1 / (settings.lipschitz_ratio * phi.norm_squared)
        self._shifts = spin_shifts(settings.spins, rows, columns)
        # Numbers of Python leave float32 as it is.
        self._momentum: list[float] = momentum(settings.iterations).tolist()

    def new_estimate(self) -> Values:
        """Return an estimate of zeros, shape (rows, columns)."""
        return np.zeros(self.shape, self.dtype)

    def solve(self, estimate: Values, sums_n: Values, weights: Values, *, relative_penalty: float = 1.0) -> int:
        """Solve in place from `estimate`, shape (rows, columns), and return the number of sums used.

        Other parameters and errors are those of `reconstructor.kernels.blocks.BlockSolver.solve`.
        """
        check_estimate(estimate, self.shape, self.dtype)
        sums, counting = checked(sums_n, weights, (self.sums,), self.dtype)
        require_number("the relative penalty", relative_penalty)
        gain, target = np.zeros((2, *self._kept.shape), self.dtype)  # of the rows of all blocks, sent or not
        gain[self._kept] = counting * self._step
        target[self._kept] = np.where(counting > 0, sums, 0) * gain[self._kept]
        threshold = self._settings.penalty_n * self._step * relative_penalty
        if self._settings.scaled_start:
            estimate *= _agreement(gain * self._transformed(estimate), target)

        def descent(ahead: Values) -> Values:
            residual = gain * self._transformed(ahead) - target
            slope: Values = (residual @ self._hadamard).reshape(-1)[self._place].reshape(self.shape)
            return slope

        def proximal(image: Values, iteration: int) -> Values:
            down, right = self._shifts[iteration % len(self._shifts)]
            coefficients = self._psi.forward(np.roll(image, (down, right), axis=(0, 1)))
            made = np.roll(self._psi.adjoint(soft(coefficients, threshold)), (-down, -right), axis=(0, 1))
            return np.maximum(made, 0) if self._settings.nonnegative else made

        estimate[:] = iterate(estimate, descent, proximal, self._momentum)
        return int(np.count_nonzero(counting))

    def _transformed(self, image: Values) -> Values:
        """Return the Hadamard transform of each block, shape (blocks, block_size)."""
        transformed: Values = image.reshape(-1)[self._order].reshape(self._kept.shape) @ self._hadamard
        return transformed

    def reset(self) -> None:
        """Do nothing: the estimate is the only state."""

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return a new image of shape (rows, columns), negative forces as 0."""
        kept = placed("estimate", estimate, self.shape, self.dtype)
        return np.maximum(kept, 0).astype(np.float32)


def _agreement(seen: Values, target: Values) -> float:
    """Return max(0, 2a - 1), a = argmin ‖a seen - target‖, at most 1; see `SolverSettings.scaled_start`."""
    explained, energy = float(np.vdot(seen, target)), float(np.vdot(seen, seen))
    excess = 2 * explained - energy
    return 1.0 if excess >= energy else max(0.0, excess / energy)
