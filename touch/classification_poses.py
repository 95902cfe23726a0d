"""The observations that the paper classifies: 16 objects, each touched from 360 offsets (section V-B)."""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import InputError
from skin.ranges import require_number
from skin.sources import OBJECT_GROUPS
from touch.coarse_arrays import Kind, averaged, grid_of
from touch.contact import Force, Pose, Spheres, press_along
from touch.objects import checked_names, spheres_of
from touch.trajectory import PAPER_DEPTH_M

#: The paper's 16 objects; the golf ball is not among them.
CLASSIFICATION_OBJECTS: Final = OBJECT_GROUPS["paper"]
#: Offsets of the array along its rows and along its columns.
OFFSETS_M: Final = (0.0, 0.002, 0.004, 0.006, 0.008, 0.010)
#: Rotations of the array about its normal.
ROTATIONS_RAD: Final = tuple(math.radians(angle) for angle in range(0, 50, 5))
PERTURBATIONS: Final = len(OFFSETS_M) ** 2 * len(ROTATIONS_RAD)


def poses(perturbations: int = PERTURBATIONS, seed: int = 0) -> list[Pose]:
    """Return the object's poses in the frame of the moved and turned array, 1 to 360, at the paper's full depth.

    Parameters
    ----------
    perturbations : int
        360 for all perturbations of the paper, ordered by offset along the rows, offset along the columns, rotation. A
        smaller number is drawn from them without repetition.
    seed : int
        Seed of the draw. The same number and seed give the same poses for every object and array.
    """
    if not 1 <= perturbations <= PERTURBATIONS:
        raise InputError(f"expected 1 to {PERTURBATIONS} perturbations, got {perturbations}")
    require_number("seed", seed)
    every = [
        # When the array moves one way, the object moves the other way relative to the array.
        Pose(0.0 - x_m, 0.0 - y_m, 0.0 - rotation_rad, PAPER_DEPTH_M)
        for x_m, y_m, rotation_rad in itertools.product(OFFSETS_M, OFFSETS_M, ROTATIONS_RAD)
    ]
    if perturbations == PERTURBATIONS:
        return every
    drawn = np.random.default_rng(seed).choice(PERTURBATIONS, perturbations, replace=False)
    return [every[index] for index in sorted(drawn)]


def observations(
    side: int = 64,
    kind: Kind = "averaged",
    *,
    perturbations: int = PERTURBATIONS,
    seed: int = 0,
    meshes: str | Path | None = None,
    names: Sequence[str] | None = None,
) -> Force:
    """Return the true force of one array under every object from every offset.

    Parameters
    ----------
    side : int
        Taxels along a side, one of `touch.coarse_arrays.ARRAYS`.
    kind : str
        Type of the coarse taxels, see `touch.coarse_arrays`.
    perturbations, seed : int
        See `poses`.
    meshes : pathlib.Path, optional
        Folder of meshes, see `touch.objects.spheres_of`.
    names : sequence of str, optional
        Objects of the catalogue; default: the paper's 16.

    Returns
    -------
    numpy.ndarray
        float32, shape (objects, perturbations, side, side), newtons; no noise.
    """
    listed = CLASSIFICATION_OBJECTS if names is None else checked_names(names)
    drawn = poses(perturbations, seed)
    return np.stack([observe(spheres_of(name, meshes), drawn, side, kind) for name in listed])


def observe(spheres: Spheres, at: Sequence[Pose], side: int, kind: Kind) -> Force:
    """Return the true force of one array under one object at each pose, float32, shape (poses, side, side)."""
    force_n = press_along(grid_of(side, kind), spheres, at)
    return averaged(force_n, side) if kind == "averaged" else force_n
