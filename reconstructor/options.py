"""Options of the solver, common to ``skin reconstruct`` and ``skin replay``."""

from dataclasses import dataclass, replace

from cyclopts import Parameter

from canskin.errors import InputError
from reconstructor.bases.names import wavelet_basis_name
from reconstructor.settings import SolverSettings, preset
from skin.layout import Layout


@Parameter(name="*")
@dataclass(frozen=True)
class SolverOptions:
    """Choice of the solver.

    Parameters
    ----------
    solver : str
        ``live``: total variation, non-negative forces, sums averaged by the temporal filter. ``variation``: total
        variation, non-negative forces, sums of one cycle. ``spun``: cycle-spun Haar wavelets. ``paper``: the paper's
        solver, tensor Haar, L = 2B. ``paper-contourlet``: the paper's solver with contourlets.
    iterations : int
        FISTA iterations per image; default: those of the solver.
    basis : str
        Orthogonal wavelet in place of the solver's total variation or Haar wavelets, with the name of PyWavelets:
        ``sym4`` or ``sym4-pyramid`` for Mallat's pyramid, ``sym4-tensor`` for the paper's form.
    penalty_n : float
        λ in newtons; default: that of the solver.
    noise_n : float
        Standard deviation of the noise of a sensor that clips at 0, newtons; corrects the bias of clipping.
        Nodes that average (``sampling.rate_hz``) learn the noise and correct the bias themselves; an analogue front end
        (``taxels.frontend``) clips no taxel and has no bias.
    """

    solver: str = "live"
    iterations: int | None = None
    basis: str | None = None
    penalty_n: float | None = None
    noise_n: float | None = None

    def clipped_noise_n(self, layout: Layout) -> float | None:
        """Return `noise_n`; raise InputError if the taxels of the layout are not clipped."""
        if self.noise_n and layout.taxels.is_analogue:
            raise InputError("--noise-n is for taxels that are clipped, not for an analogue front end: leave it out")
        return self.noise_n

    def check(self, layout: Layout) -> None:
        """Raise InputError if the solver cannot make the images of this skin."""
        self.clipped_noise_n(layout)
        if self.settings().temporal_filter and not layout.sends.in_cycles:
            raise InputError(
                f"--solver {self.solver} averages the sums of cycles, and steps have none: expected another,"
                " such as variation, spun, paper or paper-contourlet, or no option for the solver of steps"
            )

    def settings(self) -> SolverSettings:
        """Return the settings of the solver, changed by the given options."""
        chosen = preset(self.solver)
        if self.basis is not None and chosen.prior == "contourlet":
            raise InputError(f"--basis: '{self.solver}' has contourlets as its basis: take another --solver")
        return replace(
            chosen,
            prior=chosen.prior if self.basis is None else wavelet_basis_name(self.basis),
            iterations=chosen.iterations if self.iterations is None else self.iterations,
            penalty_n=chosen.penalty_n if self.penalty_n is None else self.penalty_n,
        )
