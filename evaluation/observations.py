"""What the recognition of objects is measured on: signals of every observation, and splits of the observations."""

from functools import cache
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from evaluation.solvers.noiselet import Noiselet, noiselet
from reconstructor.checks import Values
from skin.operator import Operator
from skin.phi import Sbhe, sbhe
from skin.taxel import sense
from touch.classification_poses import CLASSIFICATION_OBJECTS, PERTURBATIONS, observations
from touch.coarse_arrays import averaged

#: "averaged" and "large" are the readings of the paper's coarse arrays, see `touch.coarse_arrays`.
KINDS: Final = ("sbhe", "noiselet", "averaged", "large")
TAXELS: Final = 4096
OBJECTS: Final = len(CLASSIFICATION_OBJECTS)
#: Label of every row of a signal: observations are ordered by object, then by perturbation.
LABELS: Final = np.repeat(np.arange(OBJECTS), PERTURBATIONS)
Indices = npt.NDArray[np.intp]


@cache
def true_force_n(meshes: str | None, kind: str = "averaged", side: int = 64) -> npt.NDArray[np.float32]:
    """Return the true forces of an array, float32, shape (observations, side, side), newtons; made once."""
    if kind == "averaged" and side < 64:
        return averaged(true_force_n(meshes), side)
    force_n = observations(side, "large" if kind == "large" else "averaged", meshes=meshes)
    return force_n.reshape(-1, side, side)


@cache
def sensed(meshes: str | None, seed: int) -> npt.NDArray[np.float32]:
    """Return what the 4096 taxels felt, float32, shape (observations, 4096), newtons.

    All measurements share its noise, as they share the data set in the paper.
    """
    rng = np.random.default_rng([seed, 0])
    return sense(true_force_n(meshes), rng).reshape(-1, TAXELS)


def drawn_sbhe(size: int, draw: int) -> Sbhe:
    """Return the draw number `draw` of an SBHE with `size` sums; rows are drawn as in the paper."""
    return sbhe(TAXELS, size, selection="uniform", seed=1000 + draw)


def phi_of(kind: str, size: int, draw: int) -> Sbhe | Noiselet:
    """Return the draw number `draw` of a measurement operator with `size` sums."""
    if kind == "sbhe":
        return drawn_sbhe(size, draw)
    return noiselet(64, 64, size, seed=1000 + draw)


def all_rows(draw: int) -> Sbhe:
    """Return the SBHE of that draw with every row kept."""
    return sbhe(TAXELS, TAXELS, seed=1000 + draw)


def measured(phi: Operator, felt: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return Φ of many observations, shape (observations, m): as a matrix product where that is the faster way."""
    sums, taxels = phi.shape
    if 2 * sums >= taxels:
        return np.asarray(phi.forward(felt), np.float32)
    matrix = phi.adjoint(np.eye(sums, dtype=np.float32))
    product: npt.NDArray[np.float32] = felt @ matrix.T
    return product


def signal(kind: str, size: int, draw: int, meshes: str | None, seed: int) -> Values:
    """Return a signal of every observation, shape (observations, size).

    Compressed signals are sums of the 4096 taxels; the coarse arrays' noise comes after the cells' mean.
    """
    if kind in {"sbhe", "noiselet"}:
        return measured(phi_of(kind, size, draw), sensed(meshes, seed))
    if size == TAXELS:
        return sensed(meshes, seed)
    side = round(size**0.5)
    rng = np.random.default_rng([seed, size, kind == "large"])
    return sense(true_force_n(meshes, kind, side), rng).reshape(-1, size)


class Split(NamedTuple):
    """Rows of a signal in each part; all objects of a perturbation are in the same part (section VI-B)."""

    development: Indices
    validation: Indices
    test: Indices

    @property
    def training(self) -> Indices:
        """Development and validation set together."""
        return np.concatenate([self.development, self.validation])


def draw_split(number: int, development: float, validation: float, seed: int = 0) -> Split:
    """Return split number `number`: parts of the perturbations, at least one in each, drawn uniformly.

    Parameters
    ----------
    development, validation : float
        Ratios of the 360 perturbations; what is left is the test set.
    """
    first = max(1, round(development * PERTURBATIONS))
    second = first + max(1, round(validation * PERTURBATIONS))
    drawn = np.random.default_rng([seed, number]).permutation(PERTURBATIONS)
    first_rows = np.arange(OBJECTS)[:, None] * PERTURBATIONS
    return Split(*((first_rows + np.sort(part)).ravel() for part in np.split(drawn, [first, second])))
