"""The choice of a compiled solver."""

from reconstructor.kernels.contourlet import ContourletSolver
from reconstructor.kernels.fused import FusedSolver
from reconstructor.settings import SolverSettings
from skin.measurement import Sbhe


def make_solver(phi: Sbhe, rows: int, columns: int, settings: SolverSettings) -> FusedSolver | ContourletSolver:
    """Return the compiled solver of a prior, in float32."""
    solver = ContourletSolver if settings.prior == "contourlet" else FusedSolver
    return solver(phi, rows, columns, settings)
