"""The touches every scheme is shown: the paper's slides, and those that favour one scheme or another."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from skin.layout import Taxels
from skin.sources import OBJECT_GROUPS, object_file, object_label
from skin.taxel import NOISE_N, sense, to_counts
from touch.contact import Force, Grid, Pose, press
from touch.objects import spheres_of
from touch.primitives import ball
from touch.trajectory import ACQUISITION_OBJECTS, PAPER_DEPTH_M, PAPER_PRESS_STEPS, paper_pose, trajectory

Poses = Callable[[int], Iterator[tuple[str, Pose]]]

_ARRAY: Final = Taxels()
#: The default skin's array: taxels of a side, and of all; newtons of one count of its converters.
SIDE: Final = _ARRAY.rows
TAXELS: Final = _ARRAY.count
NEWTON_PER_COUNT: Final = _ARRAY.newton_per_count
#: The press and as much of the slide as shows it.
SLIDE_TICKS: Final = 2400
TICKS: Final = 1500
#: When the slap begins.
SLAP_MS: Final = 300
SLAP: Final = "three boxes slapped on"
SHAKING: Final = "two boxes shaking"
#: Slowest and fastest object of drawn scenes, and how far it slides to each side.
DRAWN_M_PER_S: Final = (0.02, 0.5)
DRAWN_REACH_M: Final = 0.04
#: How the two boxes shake: rates that no scan keeps step with, mean depth, and the part of it by which they swing.
#: They are pressed up to 26 times as fast as the paper's objects.
SHAKING_HZ: Final = (7.3, 9.1)
SHAKING_DEPTH_M: Final = 0.005
SHAKING_SWING: Final = 0.9


class Scene(NamedTuple):
    """A touch, one tick a millisecond.

    Attributes
    ----------
    true_n : array of float32, shape (ticks, TAXELS)
        What presses, newtons.
    counts : array of int16, shape (ticks, TAXELS)
        What 10-bit converters make of what the sensor feels.
    """

    true_n: Force
    counts: npt.NDArray[np.int16]


def _resting(tick: int) -> Iterator[tuple[str, Pose]]:
    pose = paper_pose(min(tick, PAPER_PRESS_STEPS - 1), (0.013, 0.022))
    yield "golf-ball", pose


def _fingertips(tick: int) -> Iterator[tuple[str, Pose]]:
    places = ((-0.05, 0.02), (-0.03, 0.05), (-0.01, 0.058), (0.012, 0.05), (0.04, -0.01))
    for finger, (x, y) in enumerate(places):
        depth = (0.005 + 0.001 * finger) * min(1.0, max(0.0, (tick - 100 - 40 * finger) / 150))
        yield "fingertip", Pose(x, y, 0.0, depth)


def _faint(tick: int) -> Iterator[tuple[str, Pose]]:
    yield "granola-box", Pose(0.01 + 1e-5 * tick, 0.0, 0.3, 0.002 * min(1.0, tick / 200))


def _slap(tick: int) -> Iterator[tuple[str, Pose]]:
    depth = PAPER_DEPTH_M * min(1.0, max(0.0, (tick - SLAP_MS) / 5))
    for name, x, y in (("granola-box", 0.0, -0.07), ("cracker-box", -0.01, 0.02), ("cereal-box", 0.0, 0.09)):
        yield name, Pose(x, y, 0.0, depth)


def _shaking(tick: int) -> Iterator[tuple[str, Pose]]:
    boxes = (("granola-box", 0.0, -0.05), ("cracker-box", -0.01, 0.06))
    for (name, x, y), rate_hz in zip(boxes, SHAKING_HZ, strict=True):
        swing = 1.0 + SHAKING_SWING * math.sin(2 * math.pi * rate_hz * tick * 1e-3)
        yield name, Pose(x, y, 0.1, SHAKING_DEPTH_M * min(1.0, tick / 300) * swing)


@dataclass(frozen=True)
class _Stroke:
    """An object that is pressed in, and then slides to and fro on a straight line."""

    name: str
    start_m: tuple[float, float]
    direction_rad: float
    rotation_rad: float
    depth_m: float
    pressed_ms: float
    speed_m_per_s: float

    def pose(self, tick: int) -> Pose:
        """Return the pose at a tick."""
        way_m = self.speed_m_per_s * max(0.0, tick - self.pressed_ms) * 1e-3
        place_m = abs((way_m + DRAWN_REACH_M) % (4 * DRAWN_REACH_M) - 2 * DRAWN_REACH_M) - DRAWN_REACH_M
        x, y = (start + place_m * part for start, part in zip(self.start_m, self._towards(), strict=True))
        return Pose(x, y, self.rotation_rad, self.depth_m * min(1.0, tick / self.pressed_ms))

    def _towards(self) -> tuple[float, float]:
        return math.cos(self.direction_rad), math.sin(self.direction_rad)


def _drawn(number: int, scene_seed: int) -> list[_Stroke]:
    """Draw one or two strokes: one of the paper's objects, any place, direction, depth and speed."""
    rng, (slowest, fastest) = np.random.default_rng([scene_seed, number]), DRAWN_M_PER_S
    return [
        _Stroke(
            str(rng.choice(OBJECT_GROUPS["paper"])),
            (float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.05, 0.05))),
            float(rng.uniform(0, 2 * math.pi)),
            float(rng.uniform(0, math.pi)),
            float(rng.uniform(0.2, 1.0)) * PAPER_DEPTH_M,
            float(rng.uniform(50, 400)),
            float(slowest * (fastest / slowest) ** rng.uniform()),
        )
        for _ in range(1 + int(rng.random() < 0.3))
    ]


def _nothing(tick: int) -> Iterator[tuple[str, Pose]]:
    del tick
    yield from ()


#: Beside the slides: what happens, by name.
OWN: Final[dict[str, Poses]] = {
    "nothing": _nothing,
    "golf ball at rest": _resting,
    "five fingertips": _fingertips,
    "faint box": _faint,
    SLAP: _slap,
    SHAKING: _shaking,
}
SLIDES: Final = tuple(ACQUISITION_OBJECTS)
#: Milliseconds before the touch, in which nodes learn their noise; fewer before a touch that is cut short.
IDLE_TICKS: Final = 4000
IDLE_TICKS_SHORT: Final = 1000


@dataclass(frozen=True)
class Touch:
    """What happens, and how noisy the sensor is.

    Attributes
    ----------
    name : str
        Of `SLIDES` or `OWN`, or a mesh as ``FILE@UNIT``; of a drawn scene its number.
    ticks : int, optional
        Number of milliseconds from the start; without it, all of the scene.
    noise_n : float
        Standard deviation of the sensor's noise, newtons.
    meshes : str, optional
        Folder of meshes that take the place of the shapes that ship.
    seed : int
        Of the noise.
    scene_seed : int, optional
        Of a drawn scene: objects, places, directions, depths and speeds.
    """

    name: str
    ticks: int | None = None
    noise_n: float = NOISE_N
    meshes: str | None = None
    seed: int = 0
    scene_seed: int | None = None

    @property
    def words(self) -> str:
        """What it is called in a table."""
        if self.scene_seed is not None:
            strokes = _drawn(int(self.name), self.scene_seed)
            return " and ".join(f"{each.name} at {each.speed_m_per_s:.2f} m/s" for each in strokes)
        said = [object_label(self.name)]
        said += [f"noise {1e3 * self.noise_n:g} mN"] if self.noise_n != NOISE_N else []
        return ", ".join(said)

    def sensed(self, force_n: Force, rng: np.random.Generator) -> Force:
        """Return what sensors make of true forces, shape (ticks, taxels)."""
        felt: Force = sense(force_n, rng, self.noise_n)
        return felt

    def idle(self, cells: int = TAXELS) -> npt.NDArray[np.int16]:
        """Return what every cell reads before the touch, counts, shape (ticks, cells): noise alone."""
        force_n = np.zeros((IDLE_TICKS_SHORT if self.ticks else IDLE_TICKS, cells), np.float32)
        return counts_of(self.sensed(force_n, np.random.default_rng([self.seed, 1])))

    def load(self) -> Scene:
        """Return the scene itself; the last one is kept."""
        return _scene(self)


@lru_cache(maxsize=1)
def _scene(touch: Touch) -> Scene:
    meshes, ticks = Path(touch.meshes) if touch.meshes else None, touch.ticks or TICKS
    if touch.name in SLIDES or object_file(touch.name) is not None:
        true = trajectory(touch.name, meshes=meshes, steps=touch.ticks or SLIDE_TICKS)
    elif touch.scene_seed is not None:
        strokes = _drawn(int(touch.name), touch.scene_seed)
        posed = ([(each.name, each.pose(tick)) for each in strokes] for tick in range(ticks))
        true = np.stack([_pressed(iter(each), meshes) for each in posed])
    else:
        true = np.stack([_pressed(OWN[touch.name](tick), meshes) for tick in range(ticks)])
    flat = true.reshape(len(true), TAXELS)
    return Scene(flat, counts_of(touch.sensed(flat, np.random.default_rng(touch.seed))))


def _pressed(objects: Iterator[tuple[str, Pose]], meshes: Path | None) -> Force:
    fingertip = ball(0.016)
    named = ((fingertip if name == "fingertip" else spheres_of(name, meshes), pose) for name, pose in objects)
    return press(Grid(), named)


def counts_of(felt_n: Force) -> npt.NDArray[np.int16]:
    """Return what 10-bit converters make of forces."""
    return to_counts(felt_n, _ARRAY).astype(np.int16)
