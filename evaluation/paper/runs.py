"""One trajectory, measured with one Φ and rebuilt step by step as the paper does it (sections V and VI)."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Final

import numpy as np
import numpy.typing as npt

from evaluation.printed import BasisName, Matrix
from evaluation.result import Options, Row
from evaluation.solvers.noiselet import Noiselet, noiselet
from reconstructor.bases import Basis, wavelet_basis
from reconstructor.checks import Values
from reconstructor.engine import Solver, make_solver
from reconstructor.fista import fista, largest_eigenvalue
from reconstructor.kernels.contourlet import CompiledContourlet
from reconstructor.settings import PAPER, PAPER_CONTOURLET, SolverSettings
from skin.operator import Operator
from skin.phi import sbhe
from skin.psnr import psnr_series_db
from skin.taxel import sense
from touch.contact import Force
from touch.trajectory import ACQUISITION_OBJECTS, trajectory

OBJECTS: Final = tuple(ACQUISITION_OBJECTS)
SIDE: Final = 64
#: λ for noiselets, newtons: the printed one. For SBHE a tenth of the printed one fits the tables, see `PAPER`.
NOISELET_PENALTY_N: Final = 1.0
#: Beside the progress bar of `measure`.
RECONSTRUCTIONS: Final = "reconstructions"
#: Steps whose sums are formed at a time: Φ works in the cache.
CHUNK: Final = 100
Decibels = npt.NDArray[np.float64]


class NoiseletSolver:
    """`reconstructor.fista.fista` from image to image, Φ a noiselet, with Haar or the contourlet, in float32."""

    def __init__(self, phi: Noiselet, settings: SolverSettings) -> None:
        psi: Basis
        if settings.prior == "contourlet":
            psi = CompiledContourlet(phi.rows, phi.columns, np.float32)
            largest = largest_eigenvalue(phi, CompiledContourlet(phi.rows, phi.columns))
        else:
            psi = wavelet_basis(settings.prior, phi.rows, phi.columns, np.float32)
            largest = phi.norm_squared
        self._psi = psi
        self._fista = partial(
            fista,
            phi,
            psi,
            penalty_n=settings.penalty_n,
            lipschitz=settings.lipschitz_ratio * largest,
            iterations=settings.iterations,
        )

    def new_estimate(self) -> Values:
        """Return coefficients of zeros."""
        return np.zeros(self._psi.shape, np.float32)

    def solve(self, estimate: Values, sums_n: Values, _weights: Values) -> None:
        """Improve the coefficients in place, of sums in newtons, shape (m,)."""
        estimate[...] = self._fista(sums_n, start=estimate)

    def deliver(self, estimate: Values) -> Force:
        """Return a new image of shape (rows, columns), negative forces as 0."""
        return np.maximum(self._psi.adjoint(estimate), 0)


ImageSolver = Solver | NoiseletSolver


@dataclass(frozen=True)
class Method:
    """How a trajectory is measured and rebuilt: kind of Φ, m, Ψ, and FISTA iterations of each step.

    The rows of Φ are drawn uniformly, as in the paper.
    """

    matrix: Matrix
    sums: int
    basis: BasisName
    iterations: int

    def make(self, seed: int) -> tuple[Operator, ImageSolver]:
        """Return a drawn Φ and its solver with the paper's settings: L twice the largest eigenvalue."""
        settings = replace(PAPER_CONTOURLET if self.basis == "contourlet" else PAPER, iterations=self.iterations)
        if self.matrix == "noiselet":
            drawn = noiselet(SIDE, SIDE, self.sums, seed=seed)
            return drawn, NoiseletSolver(drawn, replace(settings, penalty_n=NOISELET_PENALTY_N))
        phi = sbhe(SIDE * SIDE, self.sums, selection="uniform", seed=seed)
        return phi, make_solver(phi, SIDE, SIDE, settings)


@lru_cache(maxsize=1)
def true_force(name: str, meshes: str | None, stride: int) -> Force:
    """Return every `stride`-th step of a trajectory, newtons, shape (steps, 64, 64)."""
    return trajectory(name, meshes=meshes, speed=stride)


def felt_force(true: Force, seed: int, draw: int) -> Force:
    """Return the sensor signal of one draw of the noise."""
    return sense(true, np.random.default_rng((seed, draw)))


def phi_seed(seed: int, draw: int) -> int:
    """Return the seed of one draw of Φ."""
    return 1000 * seed + draw + 1


def sums_of(phi: Operator, felt: Force) -> npt.NDArray[np.float32]:
    """Return the sums of every step, newtons, shape (steps, m)."""
    flat = felt.reshape(len(felt), -1)
    parts = [phi.forward(flat[start : start + CHUNK]) for start in range(0, len(flat), CHUNK)]
    return np.concatenate(parts).astype(np.float32)


def rebuilt_images(phi: Operator, solver: ImageSolver, felt: Force) -> Iterator[Force]:
    """Yield the image of every step, newtons, each started from the step before."""
    estimate, weights = solver.new_estimate(), np.ones(phi.shape[0], np.float32)
    for sums_n in sums_of(phi, felt):
        solver.solve(estimate, sums_n, weights)
        yield solver.deliver(estimate)


def summary(levels_db: Decibels) -> Row:
    """Return mean, least and largest of a series."""
    return {"mean": float(levels_db.mean()), "least": float(levels_db.min()), "most": float(levels_db.max())}


def measure(*, name: str, meshes: str | None, stride: int, seed: int, draw: int, method: Method, series: bool) -> Row:
    """Return mean, least and largest PSNR of one draw, dB, and with `series` that of every step."""
    true = true_force(name, meshes, stride)
    phi, solver = method.make(phi_seed(seed, draw))
    found = psnr_series_db(true, rebuilt_images(phi, solver, felt_force(true, seed, draw)))
    return summary(found) | ({"psnr_db": [round(each, 3) for each in found.tolist()]} if series else {})


def cell(name: str, method: Method, options: Options, *, draw: int = 0, stride: int = 1, series: bool = False) -> Row:
    """Return the arguments of `measure` for a cell."""
    return {**options.shared, "name": name, "stride": stride, "draw": draw, "method": method, "series": series}
