"""FISTA, ADMM and smoothed L0 with all their settings, run alike."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.paper.runs import PENALTY_N, SIDE
from evaluation.solvers.baselines import admm, smoothed_l0
from reconstructor.bases import Basis
from reconstructor.fista import fista
from skin.operator import Operator

SUMS: Final = 1024
PENALTY: Final = PENALTY_N["sbhe", "haar"]
#: What each rival may choose from, once for each budget: ρ over the norm of Φ's rows, and the last σ, newtons.
COUPLINGS: Final = (0.03, 0.1, 0.3, 1.0)
SMALLEST_N: Final = (0.0001, 0.0002, 0.0005, 0.001)
#: Norm of the residual that smoothed L0 keeps, newtons: that of the noise, √m times 3.3 mN.
TOLERANCE_N: Final = 0.0033 * SUMS**0.5
STARTS: Final = ("cold", "warm")
Values = npt.NDArray[np.floating[Any]]
#: Takes numbers of iterations and the start, and returns the coefficients after each of these numbers.
Run = Callable[[set[int], Values | None], dict[int, Values]]
#: The method whose iterations set the budgets.
PAPERS: Final = "FISTA"


@dataclass(frozen=True)
class Contender:
    """A method with one of its settings.

    Attributes
    ----------
    method, setting : str
        As shown.
    run : callable
        Makes the coefficients.
    starts : tuple of str
        Those of `STARTS` that it can begin from.
    same_objective : bool
        True where it minimises FISTA's objective, so that its gap says something.
    """

    method: str
    setting: str
    run: Run
    starts: tuple[str, ...] = STARTS
    same_objective: bool = True


def make_contenders(phi: Operator, psi: Basis, sums_n: Values) -> list[Contender]:
    """Return each method with each of its settings."""
    norm = phi.norm_squared

    def stepped(ratio: float) -> Run:
        return _observed(partial(fista, phi, psi, sums_n, penalty_n=PENALTY, lipschitz=ratio * norm))

    def coupled(ratio: float) -> Run:
        return _observed(partial(admm, phi, psi, sums_n, penalty_n=PENALTY, coupling=ratio * norm))

    def smoothed(smallest_n: float) -> Run:
        # How fast σ falls depends on how many steps there are: each number of iterations is a run of its own.
        return lambda counts, _start: {count: _smoothed(phi, psi, sums_n, smallest_n, count) for count in counts}

    return [
        Contender(PAPERS, "L = 2B (paper)", stepped(2.0)),
        Contender("FISTA, exact step", "L = B", stepped(1.0)),
        *(Contender("ADMM", f"ρ = {ratio:g} B", coupled(ratio)) for ratio in COUPLINGS),
        *(
            # It begins from the least-squares solution, whatever the frame before.
            Contender("smoothed L0", f"σ to {1e3 * smallest:g} mN", smoothed(smallest), ("cold",), same_objective=False)
            for smallest in SMALLEST_N
        ),
    ]


def _observed(solve: Callable[..., Values]) -> Run:
    """Return what runs `solve` once, as long as the largest number asks, and keeps the estimates on its way."""

    def run(counts: set[int], start: Values | None) -> dict[int, Values]:
        kept: dict[int, Values] = {}

        def observe(iteration: int, estimate: Values) -> None:
            if iteration in counts:
                kept[iteration] = estimate.copy()

        solve(iterations=max(counts), start=start, observe=observe)
        return kept

    return run


def _smoothed(phi: Operator, psi: Basis, sums_n: Values, smallest_n: float, count: int) -> Values:
    """Return smoothed L0's result with σ falling so fast that some `count` steps bring it to its last."""
    inner = 3 if count >= 9 else 1
    turns = max(1, round(count / inner))
    widest = 2 * float(np.abs(psi.forward(phi.adjoint(sums_n).reshape(SIDE, SIDE))).max()) / phi.norm_squared
    # The loop runs while σ is above its last: a hair less than `turns` shrinkages would leave one more.
    shrink = min(0.99, (smallest_n / widest) ** (1 / turns) * (1 - 1e-9))
    return smoothed_l0(phi, psi, sums_n, tolerance_n=TOLERANCE_N, smallest_n=smallest_n, shrink=shrink, inner=inner)
