"""The problem every solver of `skin bench reconstruct` is given, and how they compare on it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from evaluation.bench.timing import race
from evaluation.result import Row
from reconstructor.bases import Basis
from reconstructor.checks import Values
from reconstructor.fista import fista, objective
from skin.layout import load_layout
from skin.phi import Sbhe
from skin.psnr import psnr_db
from skin.taxel import sense
from touch.contact import Grid, press_along
from touch.objects import spheres_of
from touch.trajectory import paper_pose

#: The step of the paper's trajectory that is solved, and the object that slides there.
STEP: Final = 2000
OBJECT: Final = "golf-ball"
#: Iterations behind the warm start and behind the best objective.
WARM, EXACT = 60, 3000


@dataclass(frozen=True, eq=False)
class Problem:
    """min ½‖As - y‖² + λ‖s‖₁, A = ΦΨ, and a start near its solution.

    Attributes
    ----------
    matrix : float64, shape (m, p)
        A, for methods that need it.
    sums, start : float64, shape (m,) and (p,)
        y, and the previous noisy frame's solution.
    lipschitz : float
        Largest eigenvalue of AᵀA.
    best : float
        The objective's minimum, from a long run in float64.
    """

    phi: Sbhe
    psi: Basis
    true: Values
    matrix: Values
    sums: Values
    start: Values
    penalty_n: float
    lipschitz: float
    best: float
    iterations: int

    def gap(self, s: Values) -> float:
        """Return (F(s) - F*) / F* in float64."""
        residual = self.matrix @ s.astype(np.float64) - self.sums
        value = 0.5 * residual @ residual + self.penalty_n * np.abs(s.astype(np.float64)).sum()
        return float(value / self.best - 1)

    def psnr_db(self, s: Values) -> float:
        """Return the PSNR of the image, dB, negative taxels as 0."""
        image = np.maximum(self.psi.adjoint(s.astype(np.float64).reshape(self.psi.shape)), 0)
        return psnr_db(self.true, image)


def make_problem(psi: Basis, penalty_n: float, lipschitz: float, iterations: int = 20, seed: int = 1) -> Problem:
    """Return the problem of one noisy frame of the default skin, warm-started from the frame before."""
    phi = load_layout().phi()
    frames = press_along(Grid(), spheres_of(OBJECT), [paper_pose(step) for step in (STEP - 1, STEP)])
    felt = sense(frames, np.random.default_rng(seed))
    before, sums = (np.asarray(phi.forward(each.reshape(-1)), np.float64) for each in felt)
    count = int(np.prod(psi.shape))
    atoms = (psi.adjoint(atom.reshape(psi.shape)).reshape(-1) for atom in np.eye(count))
    matrix = np.stack([phi.forward(atom) for atom in atoms], axis=1)
    start = fista(phi, psi, before, penalty_n=penalty_n, lipschitz=lipschitz, iterations=WARM)
    exact = fista(phi, psi, sums, penalty_n=penalty_n, lipschitz=lipschitz, iterations=EXACT, start=start)
    return Problem(
        phi=phi,
        psi=psi,
        true=frames[1].astype(np.float64),
        matrix=matrix,
        sums=sums,
        start=start.reshape(-1),
        penalty_n=penalty_n,
        lipschitz=lipschitz,
        best=objective(phi, psi, sums, exact, penalty_n),
        iterations=iterations,
    )


@dataclass(frozen=True, eq=False)
class Method:
    """One way to solve it: `solve` does the timed work and returns what `coefficients` makes s of, shape (p,)."""

    name: str
    dtype: str
    solve: Callable[[], Any]
    coefficients: Callable[[Any], Values]


def compare(problem: Problem, methods: Sequence[Method], rounds: int) -> list[Row]:
    """Return a row for each method, all timed in turn, see `evaluation.bench.timing.race`."""
    rows = []
    for method, times_s in zip(methods, race([method.solve for method in methods], rounds), strict=True):
        s = method.coefficients(method.solve())
        rows.append(
            {
                "method": method.name,
                "dtype": method.dtype,
                "ms": 1e3 * float(np.median(times_s)),
                "ms_least": 1e3 * min(times_s),
                "gap": problem.gap(s),
                "psnr_db": problem.psnr_db(s),
            }
        )
    return rows
