"""Objects from meshes: one sphere per vertex, as the paper makes its YCB objects (section V)."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from canskin.errors import InputError
from shell.extras import not_installed
from touch.contact import TRAVEL_M, FloatArray, Spheres

#: Largest file and number of vertices; larger meshes are refused. The paper's objects have 0.5 MB and 14 000 vertices.
MOST_BYTES: Final = 256 * 2**20
MOST_VERTICES: Final = 300_000
#: Of what trimesh reads, the formats that hold one mesh and are not packed: an archive may unpack to any size.
FORMATS: Final = (".ply", ".stl", ".obj", ".off", ".glb")
#: Allowed extent of an object; a file outside these limits is probably in another unit.
SMALLEST_M, LARGEST_M = 0.005, 1.5
#: Largest radius of a sphere: larger spheres would show the vertices, not the object.
MOST_RADIUS_M: Final = 0.008
#: Longest edge of an own object; the edges of a coarser mesh are divided.
LONGEST_EDGE_M: Final = 0.002
#: Units of an own object, metres.
UNITS_M: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 0.0254}
_TURN: Final = re.compile(r"([xyz])([+-]?\d+(?:\.\d+)?)")


@dataclass(frozen=True)
class MeshPose:
    """The mesh of an object and its position under the array.

    Attributes
    ----------
    stems : tuple of str
        File names without suffix; the first file found is used.
    turns : tuple of (str, float)
        Axis and angle (radians) of the rotations, in this order, from the mesh's frame to its position under the array.
    unit : str
        One of `UNITS_M`.
    longest_edge_m : float, optional
        Longer edges are divided; None: a mesh that is too coarse is refused.
    """

    stems: tuple[str, ...]
    turns: tuple[tuple[str, float], ...]
    unit: str = "m"
    longest_edge_m: float | None = None


def own_pose(name: str) -> MeshPose:
    """Return the unit and the turns of an own object, ``FILE@UNIT`` or ``FILE@UNIT:AXISDEGREES:...``.

    Examples
    --------
    >>> own_pose("handle.stl@mm:y90").unit
    'mm'
    """
    unit, *turned = name.rpartition("@")[2].split(":")
    turns = [_TURN.fullmatch(each) for each in turned]
    if unit not in UNITS_M or not all(turns):
        raise InputError(
            f"object '{name}': expected FILE@UNIT with a unit of {', '.join(UNITS_M)}, and after it turns about an axis"
            " in degrees, for example cup.stl@mm:y90"
        )
    angles = ((each[1], math.radians(float(each[2]))) for each in turns if each)
    return MeshPose((), tuple(angles), unit, LONGEST_EDGE_M)


def find_mesh(folder: Path, pose: MeshPose) -> Path:
    """Return the file of a mesh in a folder."""
    if not folder.is_dir():
        raise InputError(f"expected a folder of meshes, got '{folder}'")
    for stem in pose.stems:
        for path in sorted(folder.glob(f"{stem}.*")):
            if path.suffix.lower() in FORMATS:
                return path
    names = " or ".join(f"{stem}.ply" for stem in pose.stems)
    raise InputError(f"no mesh {names} (or {', '.join(FORMATS[1:])}) in '{folder}': add it, or leave the folder out")


def load_mesh(path: Path, pose: MeshPose) -> Spheres:
    """Return the spheres of a mesh: one per vertex, radius = 2 x mean distance to the nearest vertex.

    The mesh is centred at the middle of its extent in x and y and at the mean of z, then rotated. Spheres that reach no
    taxel are left out.

    Raise InputError if the file cannot be read, is too large, empty or open, too coarse, or in another unit.
    """
    from scipy.spatial import KDTree

    vertices = _read(path, pose)
    near_m = KDTree(vertices).query(vertices, k=2)[0][:, 1]
    radius_m = 2.0 * float(near_m.mean())
    if radius_m > MOST_RADIUS_M:
        raise InputError(
            f"'{path}' is too coarse: its vertices lie {radius_m / 2 * 1e3:.1f} mm apart, expected at most "
            f"{MOST_RADIUS_M / 2 * 1e3:.0f} mm; subdivide it"
        )
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    middle[2] = vertices[:, 2].mean()
    placed = _turned(vertices - middle, pose.turns)
    # The array faces down: its columns have the direction of the world's x, its rows the opposite of the world's y.
    placed[:, 1] *= -1.0
    reached = placed[placed[:, 2] > placed[:, 2].max() - TRAVEL_M]
    if pose.longest_edge_m is not None:
        # Of spheres with one place across the way, the highest alone is felt.
        reached = reached[np.argsort(-reached[:, 2], kind="stable")]
        cells = np.round(reached[:, :2] / (pose.longest_edge_m / 2))
        reached = reached[np.unique(cells, axis=0, return_index=True)[1]]
    return Spheres(reached, np.full(len(reached), radius_m))


def _read(path: Path, pose: MeshPose) -> FloatArray:
    """Return the vertices of a file, shape (n, 3), after every check."""
    if not path.is_file() or path.suffix.lower() not in FORMATS:
        raise InputError(f"no mesh at '{path}': expected a file that ends in {', '.join(FORMATS)}")
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise InputError(f"'{path}' is too large: {size / 2**20:.0f} MiB, expected at most {MOST_BYTES // 2**20}")
    try:
        mesh: Any = _trimesh().load_mesh(path)
    except Exception as error:  # the readers of trimesh raise any error of their libraries
        raise InputError(f"'{path}' cannot be read as a mesh: {error or type(error).__name__}") from error
    vertices = np.asarray(getattr(mesh, "vertices", ()), np.float64) * UNITS_M[pose.unit]
    if len(vertices) < 4 or not len(getattr(mesh, "faces", ())):
        raise InputError(f"'{path}' is empty: expected a mesh with vertices and triangles")
    if not np.isfinite(vertices).all():
        raise InputError(f"'{path}' has vertices that are no finite numbers")
    _check_count(path, len(vertices))
    extent_m = float(np.ptp(vertices, axis=0).max())
    if not SMALLEST_M <= extent_m <= LARGEST_M:
        hint = f"is its unit {pose.unit}?" if pose.longest_edge_m else "scale it to metres"
        raise InputError(f"'{path}' is {extent_m:g} m long, expected {SMALLEST_M} to {LARGEST_M} m: {hint}")
    if not mesh.is_watertight:
        raise InputError(f"'{path}' is open: expected a closed surface; fill its holes")
    if pose.longest_edge_m is None:
        return vertices
    _check_count(path, math.ceil(mesh.area * UNITS_M[pose.unit] ** 2 / pose.longest_edge_m**2))
    divided: FloatArray = _trimesh().remesh.subdivide_to_size(vertices, mesh.faces, pose.longest_edge_m)[0]
    return np.unique(divided, axis=0)


def _check_count(path: Path, count: int) -> None:
    if count > MOST_VERTICES:
        raise InputError(f"'{path}' has {count} vertices, expected at most {MOST_VERTICES}: decimate it")


def _turned(points: FloatArray, turns: Sequence[tuple[str, float]]) -> FloatArray:
    from scipy.spatial.transform import Rotation

    turned = points
    for axis, angle_rad in turns:
        turned = Rotation.from_euler(axis, angle_rad).apply(turned)
    return np.array(turned)


def _trimesh() -> Any:
    try:
        import trimesh
    except ImportError as error:
        raise not_installed("meshes need the package trimesh", "mesh") from error
    return trimesh
