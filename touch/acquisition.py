"""The trajectories the paper rebuilds from sums: five objects pressed in and slid (section V-A)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from skin.errors import InputError
from touch.contact import Force, Grid, press_along
from touch.objects import spheres_of
from touch.trajectory import GOLF_START_M, PAPER_STEPS, paper_pose


@dataclass(frozen=True)
class Start:
    """Where a trajectory starts.

    Attributes
    ----------
    start_m : tuple of float
        Position x, y while the object is pressed in.
    rotation_rad : float
        Kept throughout.
    exact : bool
        True where the start is that of the authors' own file. False where it is fitted: the paper does not
        publish it, and the one on a 10 mm grid and four rotations whose coefficient counts come closest to the
        paper's Table I was taken.
    """

    start_m: tuple[float, float]
    rotation_rad: float
    exact: bool


#: The paper's five objects in the order of its tables.
ACQUISITION_OBJECTS: Final = {
    "golf-ball": Start(GOLF_START_M, 0.0, exact=True),
    "granola-box": Start((0.03, 0.03), math.pi / 2, exact=False),
    "drill": Start((0.01, 0.0), 0.0, exact=False),
    "cup": Start((0.05, 0.05), 0.0, exact=False),
    "clamp": Start((0.05, 0.07), 0.0, exact=False),
}


def trajectory(name: str, *, meshes: Path | None = None, speed: int = 1, steps: int | None = None) -> Force:
    """Return the true force of the 64 x 64 array over one of the paper's trajectories.

    Parameters
    ----------
    name : str
        One of `ACQUISITION_OBJECTS`.
    meshes : pathlib.Path, optional
        Folder of meshes, see `touch.objects.spheres_of`.
    speed : int
        Times the paper's speed: every `speed`-th of its steps.
    steps : int, optional
        How many to return; without it, to the end of the trajectory: 4200 at the paper's speed.

    Returns
    -------
    numpy.ndarray
        float32, shape (steps, 64, 64), newtons; one step per millisecond, no noise.

    Raises
    ------
    InputError
        If the name is unknown, or a number cannot be used.
    """
    taken = range(*trajectory_range(speed, steps))
    start, spheres = start_of(name), spheres_of(name, meshes)
    return press_along(Grid(), spheres, (paper_pose(step, start.start_m, start.rotation_rad) for step in taken))


def start_of(name: str) -> Start:
    """Return where the trajectory of the object called `name` starts.

    Raises
    ------
    InputError
        If the paper has no trajectory of it.
    """
    if name not in ACQUISITION_OBJECTS:
        raise InputError(f"no trajectory of '{name}': expected one of {', '.join(ACQUISITION_OBJECTS)}")
    return ACQUISITION_OBJECTS[name]


def trajectory_range(speed: int, steps: int | None) -> tuple[int, int, int]:
    """Return first step, end and stride within the paper's 4200 steps.

    Raises
    ------
    InputError
        If a number is below 1, or the trajectory has fewer steps at that speed.
    """
    if not 1 <= speed <= PAPER_STEPS:
        raise InputError(f"expected a speed of 1 to {PAPER_STEPS}, got {speed}")
    most = math.ceil(PAPER_STEPS / speed)
    if steps is not None and not 1 <= steps <= most:
        raise InputError(f"expected 1 to {most} steps at speed {speed}, got {steps}")
    return 0, PAPER_STEPS if steps is None else steps * speed, speed
