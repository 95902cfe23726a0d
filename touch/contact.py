"""The force on every taxel under rigid objects: spheres on vertical springs of 1 N/m.

A taxel is a rigid sphere on a vertical spring. An object is a rigid union of spheres. It compresses the spring by the
distance that it reaches below the untouched taxel. Neighbouring taxels are independent, and there is no friction. So
the compression of a taxel is the largest compression by any sphere (Hollis et al., "BubbleTouch", arXiv 1809.09153;
section V of the paper).
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from shell.compiled import njit
from skin.defects import STIFFNESS_N_PER_M
from skin.layout import Taxels
from skin.taxel import FORCE_MAX_N

#: Largest compression of a taxel (section V).
TRAVEL_M: Final = FORCE_MAX_N / STIFFNESS_N_PER_M
#: Pitch of the paper's array and of the default skin, and radius of a taxel's sphere: the spheres touch each other.
PITCH_M: Final = Taxels().pitch_m
TAXEL_RADIUS_M: Final = PITCH_M / 2

FloatArray = npt.NDArray[np.float64]
Force = npt.NDArray[np.float32]


class Pose(NamedTuple):
    """Pose of an object in the frame of the sensor; the origin is the middle of the array.

    Attributes
    ----------
    x_m, y_m : float
        Position along the columns (x) and down the rows (y).
    rotation_rad : float
        Rotation about the array's normal, from x towards y.
    depth_m : float
        Depth of the object's highest point below the untouched array; 0 or less: no contact.
    """

    x_m: float
    y_m: float
    rotation_rad: float
    depth_m: float


@dataclass(frozen=True, eq=False)
class Spheres:
    """A rigid object as a union of spheres.

    Attributes
    ----------
    centres_m : numpy.ndarray
        Shape (n, 3), in the object's frame; z points at the array.
    radii_m : numpy.ndarray
        Shape (n,).

    The object's highest point is moved to z = 0, so that `Pose.depth_m` means the same for all objects.
    """

    centres_m: FloatArray
    radii_m: FloatArray

    def __post_init__(self) -> None:
        centres = np.array(self.centres_m, np.float64)
        radii = np.array(self.radii_m, np.float64)
        if centres.ndim != 2 or centres.shape[1] != 3 or radii.shape != centres.shape[:1] or not radii.size:
            raise InputError(
                f"an object needs centres of shape (n, 3) and n radii: got {centres.shape} and {radii.shape}"
            )
        if not (np.isfinite(centres).all() and np.isfinite(radii).all() and (radii > 0).all()):
            raise InputError("an object's spheres need finite centres and radii above 0 m")
        centres[:, 2] -= np.max(centres[:, 2] + radii)
        centres.flags.writeable = radii.flags.writeable = False
        object.__setattr__(self, "centres_m", centres)
        object.__setattr__(self, "radii_m", radii)

    def __len__(self) -> int:
        return int(self.radii_m.size)

    def footprint_m(self, depth_m: float) -> tuple[float, float]:
        """Return length and width of the part within `depth_m` of the highest point, metres."""
        indent = np.clip(depth_m + self.centres_m[:, 2] + self.radii_m, 0.0, self.radii_m)
        span = np.sqrt(indent * (2.0 * self.radii_m - indent))[:, None]
        centres, span = self.centres_m[indent > 0.0, :2], span[indent > 0.0]
        length, width = np.max(centres + span, axis=0) - np.min(centres - span, axis=0)
        return float(length), float(width)


@dataclass(frozen=True)
class Grid:
    """A planar array of taxels; taxel (row, column) lies at x by its column and y by its row."""

    rows: int = 64
    columns: int = 64
    pitch_m: float = PITCH_M
    taxel_radius_m: float = TAXEL_RADIUS_M

    def __post_init__(self) -> None:
        if self.rows < 1 or self.columns < 1:
            raise InputError(f"an array needs at least 1 x 1 taxels: got {self.rows} x {self.columns}")
        for name, length in (("pitch_m", self.pitch_m), ("taxel_radius_m", self.taxel_radius_m)):
            if not (math.isfinite(length) and length > 0):
                raise InputError(f"{name} needs a length above 0 m: got {length}")

    @property
    def half_extent_m(self) -> tuple[float, float]:
        """Half the array's length along x and along y."""
        return self.columns * self.pitch_m / 2, self.rows * self.pitch_m / 2


def press(grid: Grid, objects: Iterable[tuple[Spheres, Pose]]) -> Force:
    """Return the true force of every taxel under any number of objects.

    Parameters
    ----------
    grid : Grid
        The array.
    objects : iterable of (Spheres, Pose)
        The touching objects; the object that compresses a taxel most gives its force.

    Returns
    -------
    numpy.ndarray
        float32, shape (rows, columns), newtons; no noise and no limit.
    """
    compression = np.zeros((grid.rows, grid.columns), np.float32)
    for spheres, pose in objects:
        if not all(map(math.isfinite, pose)):
            raise InputError(f"a pose needs finite numbers: got {tuple(pose)}")
        _compress(
            compression,
            spheres.centres_m,
            spheres.radii_m,
            np.array(pose, np.float64),
            (grid.pitch_m, grid.taxel_radius_m),
        )
    return compression * np.float32(STIFFNESS_N_PER_M)


def press_along(grid: Grid, spheres: Spheres, poses: Iterable[Pose]) -> Force:
    """Return the true force of every taxel while one object moves from pose to pose.

    Returns
    -------
    numpy.ndarray
        float32, shape (poses, rows, columns), newtons.
    """
    images = [press(grid, [(spheres, pose)]) for pose in poses]
    if not images:
        raise InputError("expected 1 pose or more, got none")
    return np.stack(images)


def _deepest(
    compression: Force,
    centres: FloatArray,
    radii: FloatArray,
    pose: FloatArray,
    taxel: tuple[float, float],
) -> None:
    rows, columns = compression.shape
    pitch, taxel_radius = taxel
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for k in range(radii.size):
        indent = pose[3] + centres[k, 2] + radii[k]
        if indent <= 0.0:
            continue
        reach = radii[k] + taxel_radius
        # At a larger distance the sphere does not reach the untouched taxels.
        span = math.sqrt(indent * (2.0 * reach - indent)) if indent < reach else reach
        column_at = (pose[0] + cos * centres[k, 0] - sin * centres[k, 1]) / pitch + 0.5 * (columns - 1)
        row_at = (pose[1] + sin * centres[k, 0] + cos * centres[k, 1]) / pitch + 0.5 * (rows - 1)
        first_row = int(min(max(0.0, math.ceil(row_at - span / pitch)), float(rows)))
        last_row = int(max(-1.0, min(rows - 1.0, math.floor(row_at + span / pitch))))
        first_column = int(min(max(0.0, math.ceil(column_at - span / pitch)), float(columns)))
        last_column = int(max(-1.0, min(columns - 1.0, math.floor(column_at + span / pitch))))
        for row in range(first_row, last_row + 1):
            left = reach * reach - ((row - row_at) * pitch) ** 2
            for column in range(first_column, last_column + 1):
                rest = left - ((column - column_at) * pitch) ** 2
                if rest > 0.0:
                    pushed = indent - reach + math.sqrt(rest)
                    compression[row, column] = max(compression[row, column], pushed)


_compress: Callable[..., None] = njit(cache=True)(_deepest)
