"""The settings of a solver: defaults, ranges and presets."""

import math
from dataclasses import dataclass, replace
from typing import Final

from canskin.errors import InputError
from reconstructor.bases.names import wavelet_basis_name
from reconstructor.checks import check_iterations, is_whole
from skin.ranges import require_number

#: Priors that are no orthonormal wavelet: no grid of a basis can be shifted.
NO_WAVELETS: Final = ("variation", "contourlet")


@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """Settings of a solver of ½‖Φx - y‖² + λ R(x).

    Attributes
    ----------
    prior : str
        R: ``variation``, the anisotropic total variation, or the l1 norm of the coefficients of a basis: ``contourlet``
        or the full name of a wavelet basis, for example ``haar-pyramid`` or ``sym4-tensor``.
    iterations : int
        FISTA iterations of each image.
    penalty_n : float
        λ, newtons.
    lipschitz_ratio : float
        L / largest eigenvalue of the problem, at least 1; the paper takes 2.
    spins : int
        Cycle spinning: number of shifts of the basis, another shift in each iteration; 1 keeps the basis fixed.
        Wavelets only.
    nonnegative : bool
        Set negative taxels to 0 in every iteration.
    scaled_start : bool
        Scale each start by max(0, 2a - 1), with a = argmin ‖a Φ start - y‖, at most 1.
    temporal_filter : bool
        Average the sums over cycles before they are solved (`reconstructor.temporal_filter`), and scale λ with
        their noise. The solvers of single images leave this to `reconstructor.engine.Reconstructor`.
    """

    prior: str
    iterations: int
    penalty_n: float
    lipschitz_ratio: float = 1.0
    spins: int = 1
    nonnegative: bool = False
    scaled_start: bool = False
    temporal_filter: bool = False

    def __post_init__(self) -> None:
        check_iterations(self.iterations)
        require_number("the penalty λ", self.penalty_n)
        if not 1 <= self.lipschitz_ratio < math.inf:
            raise InputError(f"expected L / B of 1 or more, below which FISTA diverges: got {self.lipschitz_ratio}")
        if self.prior not in NO_WAVELETS and self.prior != (full := wavelet_basis_name(self.prior)):
            raise InputError(f"expected the full name '{full}', got '{self.prior}'")
        if not is_whole(self.spins) or not 1 <= self.spins <= 64:
            raise InputError(f"expected 1 to 64 spins, got {self.spins}")
        if self.spins > 1 and self.prior in NO_WAVELETS:
            raise InputError(f"'{self.prior}' has no wavelet basis to shift: expected spins of 1, got {self.spins}")
        if self.prior == "contourlet" and (self.nonnegative or self.scaled_start):
            raise InputError(
                "a contourlet is solved for its coefficients: expected neither nonnegative nor scaled_start"
            )


#: Total variation on the sums of one cycle.
VARIATION: Final = SolverSettings(
    prior="variation", iterations=10, penalty_n=0.006, nonnegative=True, scaled_start=True
)
#: The default of the service: total variation on sums averaged over time.
LIVE: Final = replace(VARIATION, temporal_filter=True)
#: Cycle-spun Haar, non-negative in every iteration, L exact.
SPUN: Final = replace(VARIATION, prior="haar-pyramid", iterations=20, penalty_n=0.008, spins=16)
#: The paper's solver: tensor Haar, L = 2B, 20 iterations, negative taxels set to 0 at the end. The printed λ = 0.1 does
#: not give the paper's tables; λ = 0.01 does, for Haar and for the contourlet.
PAPER: Final = SolverSettings(prior="haar-tensor", iterations=20, penalty_n=0.01, lipschitz_ratio=2.0)
#: The paper's solver with the contourlet.
PAPER_CONTOURLET: Final = replace(PAPER, prior="contourlet")

PRESETS: Final[dict[str, SolverSettings]] = {
    "live": LIVE,
    "variation": VARIATION,
    "spun": SPUN,
    "paper": PAPER,
    "paper-contourlet": PAPER_CONTOURLET,
}


def preset(name: str) -> SolverSettings:
    """Return the preset `name`."""
    if name not in PRESETS:
        raise InputError(f"unknown solver '{name}': expected one of {', '.join(PRESETS)}")
    return PRESETS[name]
