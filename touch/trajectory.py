"""The paper's trajectories: five objects are pressed in and slid (section V-A)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canskin.errors import InputError
from skin.sources import object_file
from touch.contact import Force, Grid, Pose, press_along
from touch.objects import checked_names, spheres_of

#: The paper's trajectory: 1 kHz, 1100 steps of pressing at 0.01 m/s from a gap of 1 mm, 3100 steps of sliding.
PAPER_STEP_S: Final = 1e-3
PAPER_STEPS: Final = 4200
PAPER_PRESS_STEPS: Final = 1100
PAPER_GAP_STEPS: Final = 100
PAPER_PRESS_M_PER_STEP: Final = 1e-5
PAPER_SLIDE_M_PER_STEP: Final = (-2e-5, -4e-5)
#: Depth at the last pressing step, also the depth of the classification data.
PAPER_DEPTH_M: Final = (PAPER_PRESS_STEPS - 1 - PAPER_GAP_STEPS) * PAPER_PRESS_M_PER_STEP
#: Start of the golf ball; the paper gives no other start.
GOLF_START_M: Final = (0.06, 0.06)


def paper_pose(step: int, start_m: tuple[float, float] = GOLF_START_M, rotation_rad: float = 0.0) -> Pose:
    """Return the pose at `step` (0 to 4199, 1 ms each) of the paper's trajectory.

    Parameters
    ----------
    step : int
        Before 0 and after the last step the pose is that of the nearest step.
    start_m : tuple of float
        Position x, y while the object is pressed in.
    rotation_rad : float
        Constant during the trajectory.
    """
    step = min(max(step, 0), PAPER_STEPS - 1)
    pressing = min(step, PAPER_PRESS_STEPS - 1)
    sliding = step - pressing
    depth = max(0, pressing - PAPER_GAP_STEPS) * PAPER_PRESS_M_PER_STEP
    dx, dy = PAPER_SLIDE_M_PER_STEP
    return Pose(start_m[0] + dx * sliding, start_m[1] + dy * sliding, rotation_rad, depth)


@dataclass(frozen=True)
class Start:
    """Start of a trajectory.

    Attributes
    ----------
    start_m : tuple of float
        Position x, y while the object is pressed in.
    rotation_rad : float
        Constant during the trajectory.
    exact : bool
        True: the start is from the authors' file. False: the start is fitted on a 10 mm grid and four rotations, so
        that the numbers of coefficients are nearest to Table I of the paper.
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


def trajectory(name: str, *, meshes: str | Path | None = None, speed: int = 1, steps: int | None = None) -> Force:
    """Return the true force of the 64 x 64 array over one of the paper's trajectories.

    Parameters
    ----------
    name : str
        One of `ACQUISITION_OBJECTS`, or ``FILE@UNIT``.
    meshes : str or pathlib.Path, optional
        Folder of meshes, see `touch.objects.spheres_of`.
    speed : int
        Speed / paper's speed: every `speed`-th step is taken.
    steps : int, optional
        Number of steps to return; default: the whole trajectory, 4200 steps at the paper's speed.

    Returns
    -------
    numpy.ndarray
        float32, shape (steps, 64, 64), newtons; one step per millisecond, no noise.
    """
    taken = range(*trajectory_range(speed, steps))
    start, spheres = start_of(name), spheres_of(name, meshes)
    return press_along(Grid(), spheres, (paper_pose(step, start.start_m, start.rotation_rad) for step in taken))


def checked_slides(names: str) -> tuple[str, ...]:
    """Return names that are separated by commas; raise InputError unless each has a trajectory."""
    listed = checked_names(names)
    for name in listed:
        start_of(name)
        spheres_of(name)
    return listed


def start_of(name: str) -> Start:
    """Return the start of the trajectory of the object `name`; raise InputError if the paper has none.

    The user's own objects start where the golf ball does.
    """
    if object_file(name) is not None:
        return Start(GOLF_START_M, 0.0, exact=False)
    if name not in ACQUISITION_OBJECTS:
        raise InputError(f"no trajectory of '{name}': expected one of {', '.join(ACQUISITION_OBJECTS)}, or FILE@UNIT")
    return ACQUISITION_OBJECTS[name]


def trajectory_range(speed: int, steps: int | None) -> tuple[int, int, int]:
    """Return first step, end and stride within the paper's 4200 steps; raise InputError unless there are such steps."""
    if not 1 <= speed <= PAPER_STEPS:
        raise InputError(f"expected a speed of 1 to {PAPER_STEPS}, got {speed}")
    most = math.ceil(PAPER_STEPS / speed)
    if steps is not None and not 1 <= steps <= most:
        raise InputError(f"expected 1 to {most} steps at speed {speed}, got {steps}")
    return 0, PAPER_STEPS if steps is None else steps * speed, speed
