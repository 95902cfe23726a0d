"""The force on every taxel under rigid objects: spheres on springs of 1 N/m along the normals of the skin.

A taxel is a rigid sphere on a spring; untouched, its highest point lies on the skin. An object is a rigid union of
spheres. It compresses the spring by the distance that the taxel must move along its own normal until it is free.
Neighbouring taxels are independent, and there is no friction. So the compression of a taxel is the largest compression
by any sphere (Hollis et al., "BubbleTouch", arXiv 1809.09153; section V of the paper). On a flat skin this is the
distance that the object reaches below the untouched taxel.

An object comes from outside, along the normal of the skin where it presses. A taxel feels a sphere if the way of the
sphere meets the untouched taxel, and the taxel faces the way or the sphere: nothing is felt by the far side of a
finger, nor by a taxel beside the way.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from shell.compiled import njit
from skin.defects import STIFFNESS_N_PER_M
from skin.layout import Taxels
from skin.surface import Floats, Indices, Surface, grid_surface
from skin.taxel import FORCE_MAX_N

#: Largest compression of a taxel (section V).
TRAVEL_M: Final = FORCE_MAX_N / STIFFNESS_N_PER_M
#: Pitch of the paper's array and of the default skin, and radius of a taxel's sphere: the spheres touch each other.
PITCH_M: Final = Taxels().pitch_m
TAXEL_RADIUS_M: Final = PITCH_M / 2
#: Most cells along a side of the table that finds the taxels under a sphere.
_MOST_CELLS: Final = 256
#: Places across a way are rounded to these decimals of a cell, so that those of a grid are whole numbers.
_DECIMALS: Final = 9
#: Views of skins that are kept: on a flat skin each pose has the same.
_VIEWS: Final = 16

FloatArray = npt.NDArray[np.float64]
Force = npt.NDArray[np.float32]
Vector = tuple[float, float, float]


class Pose(NamedTuple):
    """Pose of an object in the frame of the skin (`skin.surface`).

    Attributes
    ----------
    x_m, y_m : float
        Where the object presses; on a grid, along the columns (x) and down the rows (y).
    rotation_rad : float
        Rotation about the normal, from the first of `tangents` towards the second; on a grid, from x towards y.
    depth_m : float
        Depth of the object's highest point below the untouched skin; 0 or less: no contact.
    z_m : float
        The third coordinate of where the object presses.
    normal : tuple of float
        Direction out of the skin there, of length 1: the object's z axis is opposite.
    """

    x_m: float
    y_m: float
    rotation_rad: float
    depth_m: float
    z_m: float = 0.0
    normal: Vector = (0.0, 0.0, -1.0)


def tangents(normal: Vector) -> tuple[Vector, Vector]:
    """Return two directions along a skin that complete the direction into it; x and y for the normal of a grid."""
    x, y, z = normal
    fixed = (1.0, 0.0, 0.0) if abs(x) < 0.9 else (0.0, 1.0, 0.0)
    along = fixed[0] * x + fixed[1] * y
    first = np.array((fixed[0] - along * x, fixed[1] - along * y, -along * z))
    first /= math.sqrt(first @ first)
    second = np.cross((-x, -y, -z), first)
    return tuple(first.tolist()), tuple(second.tolist())


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

    @property
    def surface(self) -> Surface:
        """Where the taxels lie."""
        return grid_surface(self.rows, self.columns, self.pitch_m, np.empty(0, np.intp))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    def __str__(self) -> str:
        return f"{self.rows} x {self.columns} taxels {self.pitch_m:g} m apart"


@dataclass(frozen=True, eq=False)
class Shell:
    """Taxels on a surface of any shape, each with a sphere of `taxel_radius_m`."""

    surface: Surface
    taxel_radius_m: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its arrays."""
        return self.surface.shape

    def __str__(self) -> str:
        return f"{len(self.surface.positions_m)} taxels {self.surface.pitch_m:g} m apart"


#: What an object presses on.
Skin = Grid | Shell


def skin_of(rows: int, columns: int, pitch_m: float, surface: Surface | None) -> Skin:
    """Return the taxels of a grid or, if there is one, on a surface; their spheres are as wide as the pitch."""
    return Grid(rows, columns, pitch_m) if surface is None else Shell(surface, pitch_m / 2)


def press(skin: Skin, objects: Iterable[tuple[Spheres, Pose]]) -> Force:
    """Return the true force of every taxel under any number of objects.

    Parameters
    ----------
    skin : Grid or Shell
        The taxels.
    objects : iterable of (Spheres, Pose)
        The touching objects; the object that compresses a taxel most gives its force.

    Returns
    -------
    numpy.ndarray
        float32, shape (rows, columns), newtons; no noise and no limit.
    """
    compression = np.zeros(skin.shape, np.float32)
    for spheres, pose in objects:
        *placed, normal = pose
        if not all(map(math.isfinite, placed)):
            raise InputError(f"a pose needs finite numbers: got {tuple(pose)}")
        view = _view(skin, normal)
        _compress(compression.ravel(), spheres.centres_m, spheres.radii_m, np.array(placed), view)
    return compression * np.float32(STIFFNESS_N_PER_M)


def press_along(skin: Skin, spheres: Spheres, poses: Iterable[Pose]) -> Force:
    """Return the true force of every taxel while one object moves from pose to pose.

    Returns
    -------
    numpy.ndarray
        float32, shape (poses, rows, columns), newtons.
    """
    images = [press(skin, [(spheres, pose)]) for pose in poses]
    if not images:
        raise InputError("expected 1 pose or more, got none")
    return np.stack(images)


class _View(NamedTuple):
    """The taxels of a skin as an object finds them that comes along one normal.

    Attributes
    ----------
    axes : array, shape (3, 3)
        The two `tangents`, and the direction into the skin, in which the object comes.
    taxels : array, shape (n, 6)
        Of each taxel, cell by cell: column and row of the middle of its untouched sphere, on a grid whole numbers; the
        middle along the third axis, metres; and its normal along `axes`.
    number : array of int, shape (n,)
        Which taxel each line is.
    first : array of int, shape (rows * columns + 1,)
        Where each cell of the plane across the way begins, row by row.
    bounds : array, shape (8,)
        x and y of the middle of the first cell in sides of a cell; this side, metres; how far taxels lie from the
        middles of their cells, sides; rows and columns of cells; z of the highest taxel, radius of a taxel, metres.
    """

    axes: FloatArray
    taxels: Floats
    number: Indices
    first: Indices
    bounds: FloatArray


@lru_cache(maxsize=_VIEWS)
def _view(skin: Skin, normal: Vector) -> _View:
    if not abs(math.hypot(*normal) - 1.0) < 1e-6:
        raise InputError(f"a pose needs a normal of length 1: got {normal}")
    surface = skin.surface
    axes = np.array((*tangents(normal), [-each for each in normal]))
    normals = axes @ surface.normals.T
    middles = axes @ surface.positions_m.T - skin.taxel_radius_m * normals
    low, high = middles.min(axis=1), middles.max(axis=1)
    side = max(surface.pitch_m, float((high - low)[:2].max()) / _MOST_CELLS)
    across = np.round(middles[:2] / side, _DECIMALS)
    origin = across.min(axis=1)
    across -= origin[:, None]
    column, row = cell = (across + 0.5).astype(np.intp)
    slack = float(np.abs(across - cell).max())
    columns, rows = int(column.max()) + 1, int(row.max()) + 1
    number = np.argsort(row * columns + column, kind="stable")
    first = np.searchsorted((row * columns + column)[number], np.arange(rows * columns + 1))
    bounds = np.array((*origin, side, slack, rows, columns, low[2] - skin.taxel_radius_m, skin.taxel_radius_m))
    lines = np.ascontiguousarray(np.concatenate((across, middles[2:], normals))[:, number].T)
    return _View(axes, lines, number, first, bounds)


def _deepest(
    compression: Force,
    centres: FloatArray,
    radii: FloatArray,
    pose: FloatArray,
    view: _View,
) -> None:
    axes, lines, number, first, bounds = view
    left, upper, side, slack, rows, columns, top, taxel_radius = bounds
    at_x, at_y, at_z = axes[:, 0] * pose[0] + axes[:, 1] * pose[1] + axes[:, 2] * pose[4]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for k in range(radii.size):
        z = at_z + pose[3] + centres[k, 2]
        indent = z + radii[k] - top
        if indent <= 0.0:
            continue
        reach = radii[k] + taxel_radius
        # At a larger distance from its way the sphere does not reach the untouched taxels.
        span = math.sqrt(indent * (2.0 * reach - indent)) if indent < reach else reach
        column_at = (at_x + cos * centres[k, 0] - sin * centres[k, 1]) / side - left
        row_at = (at_y + sin * centres[k, 0] + cos * centres[k, 1]) / side - upper
        wide = span / side + slack
        first_row = int(min(max(0.0, math.ceil(row_at - wide)), rows))
        last_row = int(max(-1.0, min(rows - 1.0, math.floor(row_at + wide))))
        first_column = int(min(max(0.0, math.ceil(column_at - wide)), columns))
        last_column = int(max(-1.0, min(columns - 1.0, math.floor(column_at + wide))))
        if last_column < first_column:
            continue
        for row in range(first_row, last_row + 1):
            begin = first[row * int(columns) + first_column]
            for line in range(begin, first[row * int(columns) + last_column + 1]):
                dx, dy = (lines[line, 0] - column_at) * side, (lines[line, 1] - row_at) * side
                rest = reach * reach - dy * dy - dx * dx
                if rest <= 0.0:
                    continue  # beside the way of the sphere
                dz, nz = lines[line, 2] - z, lines[line, 5]
                along = -dz
                if nz > -1.0:  # the taxel does not face the way straight, as all of a flat skin do
                    nx, ny = lines[line, 3], lines[line, 4]
                    along = dx * nx + dy * ny + dz * nz
                    if (dz > 0.0 and rest <= dz * dz) or (nz >= 0.0 and along > 0.0):
                        continue  # the sphere has not come as far, or is behind the taxel
                    rest += along * along - dz * dz
                if rest > 0.0:
                    taxel = number[line]
                    compression[taxel] = max(compression[taxel], along + math.sqrt(rest))


_compress: Callable[..., None] = njit(cache=True)(_deepest)
