"""How a verb names a solver: the options that ``skin reconstruct`` and ``skin rebuild`` share."""

from dataclasses import dataclass, replace

from cyclopts import Parameter

from reconstructor.settings import SolverSettings, preset


@Parameter(name="*")
@dataclass(frozen=True)
class SolverOptions:
    """Which solver makes the images.

    Parameters
    ----------
    solver : str
        ``live``: total variation and non-negative forces on sums averaged as far as the motion allows.
        ``variation``: the same on one cycle's sums alone. ``spun``: cycle-spun Haar wavelets. ``paper``: the paper's,
        tensor Haar, L = 2B. ``paper-contourlet``: the paper's with contourlets.
    iterations : int
        FISTA iterations per image; without it the solver's own.
    penalty_n : float
        λ in newtons; without it the solver's own.
    noise_n : float
        Standard deviation of the sensor's noise in newtons, if it clips at 0: its bias is then corrected.
    """

    solver: str = "live"
    iterations: int | None = None
    penalty_n: float | None = None
    noise_n: float | None = None

    def settings(self) -> SolverSettings:
        """Return the settings of the solver, with what was given in place of its own.

        Raises
        ------
        InputError
            If there is no such solver, or a number is out of its range.
        """
        chosen = preset(self.solver)
        return replace(
            chosen,
            iterations=chosen.iterations if self.iterations is None else self.iterations,
            penalty_n=chosen.penalty_n if self.penalty_n is None else self.penalty_n,
        )
