"""The objects that can touch the skin, by name (section V of the paper)."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Final

from canskin.errors import InputError
from skin.sources import OBJECT_GROUPS, object_file, object_label, object_names
from touch import primitives
from touch.contact import Spheres
from touch.meshes import UNITS_M, MeshPose, find_mesh, load_mesh, own_pose
from touch.shapes import SHAPES


@dataclass(frozen=True)
class TouchObject:
    """An object of the catalogue, or the user's own.

    Attributes
    ----------
    name, shape : str
        Name of the object, and of its primitive.
    size_m : tuple of float, optional
        Length and width of the side that faces the array, metres; of a body of rods, those of its upper 10 mm. None: as
        the mesh has them.
    build : callable
        Returns its spheres.
    mesh : MeshPose, optional
        Mesh and position of the object; None if the paper uses a simple body.
    """

    name: str
    shape: str
    size_m: tuple[float, float] | None
    build: Callable[[], Spheres]
    mesh: MeshPose | None = None


def _ball(name: str, diameter_m: float) -> TouchObject:
    return TouchObject(name, "ball", (diameter_m, diameter_m), lambda: primitives.ball(diameter_m))


def _box(name: str, length_m: float, width_m: float) -> TouchObject:
    return TouchObject(name, "box", (length_m, width_m), lambda: primitives.box(length_m, width_m))


def _can(name: str, diameter_m: float) -> TouchObject:
    return TouchObject(name, "can", (diameter_m, diameter_m), lambda: primitives.can(diameter_m))


def _ring(name: str, diameter_m: float, wall_m: float) -> TouchObject:
    return TouchObject(name, "ring", (diameter_m, diameter_m), lambda: primitives.ring(diameter_m, wall_m))


def _own(name: str, size_m: tuple[float, float], mesh: MeshPose) -> TouchObject:
    return TouchObject(name, "own shape", size_m, SHAPES[name], mesh)


#: Depth of the side that faces the array, about the depth of the paper's presses.
FACING_M: Final = 0.01

#: Position of the authors' meshes under the array: rotation about y, then about z.
_ON_ITS_SIDE: Final = (("y", math.pi / 2), ("y", math.pi))
_DRILL: Final = MeshPose(("drill",), (("z", 5 * math.pi / 16), *_ON_ITS_SIDE))
_CLAMP: Final = MeshPose(("clamp", "largeclamp"), _ON_ITS_SIDE)
_MUSTARD_LYING: Final = MeshPose(("mustard",), (("z", math.pi / 6), *_ON_ITS_SIDE))
_MUSTARD_UPRIGHT: Final = MeshPose(("mustard",), (("z", math.pi / 6), *_ON_ITS_SIDE, ("y", math.pi / 2)))

#: Balls and boxes have the sizes of BubbleTouch's scripts. The paper gives no sizes of its cans: these are common
#: sizes, with which the classifier confuses the same objects as in the paper.
_PAPER: Final = (
    _ball("golf-ball", 0.04267),
    _ball("racquetball", 0.057),
    _ball("volleyball", 0.207),
    _ball("basketball", 0.2388),
    _box("cracker-box", 0.158, 0.060),
    _box("cereal-box", 0.197, 0.051),
    _box("jello-box", 0.085, 0.050),
    _box("granola-box", 0.141, 0.100),
    _can("gravy-can", 0.0683),
    _can("tuna-can", 0.0873),
    _can("salmon-can", 0.1032),
    _own("banana", (0.144, 0.092), MeshPose(("banana",), ())),
    _own("cup", (0.106, 0.106), MeshPose(("cup",), ())),
    _own("drill", (0.182, 0.157), _DRILL),
    _own("clamp", (0.198, 0.130), _CLAMP),
    _own("mustard-lying", (0.160, 0.075), _MUSTARD_LYING),
    _own("mustard-upright", (0.024, 0.024), _MUSTARD_UPRIGHT),
)

#: The paper's objects and a ring with the diameter and the wall of the paper's cup.
CATALOGUE: Final = {item.name: item for item in (*_PAPER, _ring("ring", 0.1004, 0.0043))}
_KNOWN: Final = ", ".join((*OBJECT_GROUPS, *CATALOGUE))


def checked_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` as `skin.sources.object_names` does, and refuse names that the catalogue does not have.

    A string may hold several names, separated by commas. The user's own objects are ``FILE@UNIT``; two objects with one
    label are refused.
    """
    listed = object_names([names] if isinstance(names, str) else names)
    if not listed:
        raise InputError(f"no object named: expected one or more of {_KNOWN}")
    labels: dict[str, str] = {}
    for name in listed:
        if labels.setdefault(_item(name).name, name) != name:
            raise InputError(f"'{labels[object_label(name)]}' and '{name}' have the same name: rename a file")
    return listed


def _item(name: str) -> TouchObject:
    """Return the object of this one name, or of a file."""
    file = object_file(name)
    if file is not None:
        return TouchObject(object_label(name), file.name, None, partial(load_mesh, file, own_pose(name)))
    if Path(name).suffix:
        raise InputError(f"in which unit is '{name}'? expected {' or '.join(f'{name}@{unit}' for unit in UNITS_M)}")
    if name not in CATALOGUE:
        raise InputError(f"unknown object '{name}': expected one of {_KNOWN}, or a mesh as FILE@UNIT")
    return CATALOGUE[name]


@cache
def spheres_of(name: str, meshes: str | Path | None = None) -> Spheres:
    """Return the spheres of the object `name`; they are built once.

    Parameters
    ----------
    name : str
        One of `CATALOGUE`, or ``FILE@UNIT``.
    meshes : str or pathlib.Path, optional
        Folder of meshes in metres, of `touch.meshes.FORMATS`: ``banana.ply``, ``drill.stl``, … Only the objects
        that the paper takes from meshes use this folder.
    """
    item = _item(name)
    if meshes is None or item.mesh is None:
        return item.build()
    return load_mesh(find_mesh(Path(meshes), item.mesh), item.mesh)


def made_of(name: str, meshes: Path | None = None) -> str:
    """Return the source of an object's spheres: a primitive, an own shape, or the name of a mesh file."""
    item = _item(name)
    if meshes is None or item.mesh is None:
        return item.shape
    return find_mesh(meshes, item.mesh).name


def size_m(name: str, meshes: Path | None = None) -> tuple[float, float]:
    """Return length and width of the side that faces the array: as built, or of the upper 10 mm of a mesh."""
    item = _item(name)
    if item.size_m is not None and (meshes is None or item.mesh is None):
        return item.size_m
    return spheres_of(name, meshes).footprint_m(FACING_M)
