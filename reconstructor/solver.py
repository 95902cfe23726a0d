"""The interface of the compiled solvers, and the choice of a solver."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from reconstructor.checks import Values
from reconstructor.kernels.contourlet import ContourletSolver
from reconstructor.kernels.fused import FusedSolver
from reconstructor.settings import SolverSettings
from skin.measurement import Sbhe


class ImageSolver(Protocol):
    """Solver of one cycle, from the estimate of the last: `FusedSolver`, `ContourletSolver`."""

    @property
    def sums(self) -> int:
        """Number of sums m."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the images."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Dtype of sums and estimates."""
        ...

    def new_estimate(self) -> Values:
        """Return an estimate of zeros."""
        ...

    def reset(self) -> None:
        """Reset the state of the solver; the estimate is no part of this state."""
        ...

    def solve(self, estimate: Values, sums_n: Values, weights: Values) -> int:
        """Improve the estimate in place."""
        ...

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return the image."""
        ...


def make_solver(
    phi: Sbhe, rows: int, columns: int, settings: SolverSettings, *, dtype: npt.DTypeLike = np.float32
) -> FusedSolver | ContourletSolver:
    """Return the compiled solver of a prior.

    Raises
    ------
    InputError
        If the grid or the settings do not fit.
    """
    solver = ContourletSolver if settings.prior == "contourlet" else FusedSolver
    return solver(phi, rows, columns, settings, dtype=dtype)
