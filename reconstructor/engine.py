"""`Reconstructor`: one tactile image per cycle, from its sums and what earlier cycles said."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from reconstructor.clipping import ClipCorrection
from reconstructor.settings import LIVE, SolverSettings
from reconstructor.solver import make_solver
from reconstructor.temporal_filter import TemporalFilter
from skin.errors import InputError
from skin.measurement import Sbhe

#: Noise of one sum of 32 idle taxels whose noise of 1 mN is clipped at 0: √(32 (1/2 - 1/2π)) mN.
SUM_NOISE_N: Final = 0.0033
#: Bounds of the λ that follows the noise, relative to `penalty_n`; without any, ten iterations fill no gaps.
LEAST_PENALTY: Final = 0.03
MOST_PENALTY: Final = 10.0


class Reconstructor:
    """The solver of the service.

    Every call starts from the previous image. A start from an image that no longer fits would leave its ghost in
    the null space of Φ, so the start is first scaled by how well it explains the sums (`scaled_start`): all of it
    while a touch moves slowly, nothing of it when another touch has taken its place.

    With `temporal_filter`, sums are averaged over cycles with the gain of `TemporalFilter`, and λ follows their noise:
    `penalty_n` is then that for sums with a noise of `SUM_NOISE_N` that are not averaged.

    The taxels of a block whose sums do not come are not measured: within a few cycles, one or two while the touch
    moves, they show what the measured taxels around them make likely, somewhat too little, and nothing of the past
    stays frozen there. Without any valid sum the image is zero and the past is forgotten.

    Parameters
    ----------
    phi : Sbhe
        The skin's Φ.
    rows, columns : int
        The grid, powers of two from 8 to 256.
    settings : SolverSettings
    noise_n : float, optional
        Standard deviation of the noise of a sensor that clips at 0; with it the bias of clipping is corrected.
    dtype : float32 or float64
        Of all arithmetic.

    Raises
    ------
    InputError
        If the grid or the settings do not fit.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        settings: SolverSettings = LIVE,
        *,
        noise_n: float | None = None,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        self._kernel = make_solver(phi, rows, columns, settings, dtype=dtype)
        self._correct = None if noise_n is None else ClipCorrection(noise_n)
        self._filter = TemporalFilter(phi.shape[0], self._kernel.dtype)
        self._settings = settings
        self._estimate = self._kernel.new_estimate()

    @property
    def gain(self) -> float:
        """The gain of the temporal filter in the last cycle, 0 to 1; always 1 without the filter."""
        return self._filter.gain

    def solve(
        self, sums_n: npt.NDArray[np.floating[Any]], valid_sums: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.float32]:
        """Return the image of one cycle.

        Parameters
        ----------
        sums_n : array, shape (m,)
            Newtons; what stands where a sum is not valid has no effect.
        valid_sums : array of bool, shape (m,)

        Returns
        -------
        array of float32, shape (rows, columns)
            Newtons, never negative.

        Raises
        ------
        InputError
            If the shapes differ from Φ's, a dtype is of another kind, or a valid sum is not finite or above 1e6 N.
        """
        filtered, kernel = self._filter, self._kernel
        for each in (sums_n, valid_sums):
            if not isinstance(each, np.ndarray):
                raise InputError(f"expected arrays, got {type(each).__name__}")
        expected = filtered.sums.shape
        if sums_n.shape != expected or valid_sums.shape != expected:
            raise InputError(
                f"Φ gives {expected[0]} sums: got sums of shape {sums_n.shape} and validity of {valid_sums.shape}"
            )
        if sums_n.dtype.kind != "f" or valid_sums.dtype != np.bool_:
            raise InputError(f"expected floats and bools, got {sums_n.dtype} and {valid_sums.dtype}")
        if not self._settings.temporal_filter:
            filtered.reset()
        with np.errstate(over="ignore"):  # what stands where a sum is not valid has no effect
            taken = filtered.take(np.ascontiguousarray(sums_n, kernel.dtype), np.ascontiguousarray(valid_sums))
        if not taken:
            raise InputError("a valid sum is not finite, or above 1e6: expected newtons")
        if not valid_sums.any():
            self.reset()
        else:
            kernel.solve(self._estimate, filtered.sums, filtered.weights, relative_penalty=self._relative_penalty())
        image = kernel.deliver(self._estimate)
        return image if self._correct is None else self._correct(image)

    def _relative_penalty(self) -> float:
        """Return by how much λ is to be scaled: with the noise that is seen, and with what is left of it."""
        if not self._settings.temporal_filter:
            return 1.0
        noise_n = self._filter.noise_n
        seen = min(max(noise_n / SUM_NOISE_N, LEAST_PENALTY), MOST_PENALTY) if noise_n else 1.0
        return seen * self._filter.noise_ratio

    def reset(self) -> None:
        """Forget the previous images and sums."""
        self._estimate[:] = 0
        self._kernel.reset()
        self._filter.reset()

    def restart(self) -> None:
        """Forget everything, as after construction."""
        self.reset()
        self._filter.restart()

    def warm_up(self) -> None:
        """Compile, or load what was compiled before, so that the first cycle is as fast as the others."""
        valid = np.ones(self._filter.sums.size, np.bool_)
        for _ in range(2):
            self.solve(np.zeros_like(self._filter.sums), valid)
        self.restart()
