"""The touches every scheme is shown: the paper's slides, and those that favour one scheme or another."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from evaluation.schemes.fresh_scenes import FIELDS, POSED, Poses, random_poses
from evaluation.schemes.sensor_noise import NoiseKind, noise_of
from skin.defects import Defects
from skin.layout import Taxels
from skin.taxel import NOISE_N, TaxelModel, to_counts
from touch.contact import Force, Grid, Pose, press
from touch.objects import spheres_of
from touch.primitives import ball
from touch.reading import read_counts
from touch.recording import Recording
from touch.trajectory import ACQUISITION_OBJECTS, PAPER_DEPTH_M, PAPER_PRESS_STEPS, paper_pose, trajectory

_ARRAY: Final = Taxels()
#: The default skin's array: taxels of a side, and of all; newtons of one count of its converters.
SIDE: Final = _ARRAY.rows
TAXELS: Final = _ARRAY.count
NEWTON_PER_COUNT: Final = _ARRAY.newton_per_count
#: The press and as much of the slide as shows it.
SLIDE_TICKS: Final = 2400
TICKS: Final = 1500
#: Time for which a recorded frame is shown: a tenth of that between two readings of the mats.
RECORDED_MS: Final = 100
RECORDED_FRAMES: Final = 24
#: When the slap begins.
SLAP_MS: Final = 300
SLAP: Final = "three boxes slapped on"
SHAKING: Final = "two boxes shaking"
#: How the two boxes shake: rates that no scan keeps step with, mean depth, and the part of it by which they swing.
#: They are pressed up to 26 times as fast as the paper's objects.
SHAKING_HZ: Final = (7.3, 9.1)
SHAKING_DEPTH_M: Final = 0.005
SHAKING_SWING: Final = 0.9


@dataclass(frozen=True, eq=False)
class Scene:
    """A touch, one tick a millisecond.

    Attributes
    ----------
    true_n, felt_n : array of float32, shape (ticks, TAXELS)
        What presses and what the sensor makes of it, newtons. Of a recording both are what was recorded.
    counts : array of int16, shape (ticks, TAXELS)
        What 10-bit converters make of `felt_n`.
    is_recorded : bool
        Whether a recording was played, whose own values, noise included, count as the truth.
    """

    true_n: Force
    felt_n: Force
    counts: npt.NDArray[np.int16]
    is_recorded: bool = False


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
#: Name of a random scene: its number and its seed.
_RANDOM: Final = re.compile(r"random scene (\d+) of seed (\d+)")


@dataclass(frozen=True)
class Touch:
    """What happens, how noisy the sensor is, and what the buses lose.

    Attributes
    ----------
    name : str
        Of `SLIDES`, `OWN` or `evaluation.schemes.fresh_scenes`, that of a `random_touch`, or the path of an ``.npz``
        whose first arrays are laid side by side, until the skin is full.
    ticks : int, optional
        Number of milliseconds from the start; without it, all of the scene.
    noise_n : float
        Standard deviation of the simulated sensor's noise, newtons; a recording has its own.
    noise : str
        What kind of noise.
    drift_n_per_s : float
        Standard deviation of the rates at which the zeros of taxels drift, from the beginning of the touch on.
    stuck : int
        Number of taxels that always read one value, while nothing touches, too.
    loss_ratio : float
        Part of all frames that never reach the receiver, 0 to 1.
    meshes : str, optional
        Folder of meshes that take the place of the shapes that ship.
    seed : int
        Of noise and losses.
    """

    name: str
    ticks: int | None = None
    noise_n: float = NOISE_N
    noise: NoiseKind = "normal"
    drift_n_per_s: float = 0.0
    stuck: int = 0
    loss_ratio: float = 0.0
    meshes: str | None = None
    seed: int = 0

    @property
    def words(self) -> str:
        """What it is called in a table."""
        name = f"recording {Path(self.name).stem}" if self.name.endswith(".npz") else self.name
        said = [name]
        said += [f"noise {1e3 * self.noise_n:g} mN"] if self.noise_n != NOISE_N else []
        said += [f"{self.noise} noise"] if self.noise != "normal" else []
        said += [f"drift {1e3 * self.drift_n_per_s:g} mN/s rms"] if self.drift_n_per_s else []
        said += [f"{self.stuck} taxels stuck"] if self.stuck else []
        said += [f"{self.loss_ratio:.0%} of frames lost"] if self.loss_ratio else []
        return ", ".join(said)

    @property
    def is_plain(self) -> bool:
        """Whether noise is the paper's, no taxel has a defect and nothing is lost."""
        without = (self.noise_n, self.noise, self.drift_n_per_s, self.stuck, self.loss_ratio)
        return without == (NOISE_N, "normal", 0.0, 0, 0.0)

    def arrives(self, frames: int) -> npt.NDArray[np.bool_]:
        """Draw which of `frames` frames reach the receiver."""
        return np.random.default_rng(self.seed).random(frames) >= self.loss_ratio

    def sensed(self, force_n: Force, rng: np.random.Generator, *, at_rest: bool = False) -> Force:
        """Return what sensors make of true forces, shape (ticks, side²); `at_rest`: no zero drifts."""
        noise_n = self.noise_n
        if self.noise != "normal":
            force_n, noise_n = force_n + noise_of(self.noise, force_n.shape, noise_n, rng), 0.0
        taxels, side = force_n.shape[1], math.isqrt(force_n.shape[1])
        amounts = {"drift": 0.0 if at_rest else self.drift_n_per_s, "stuck": self.stuck / taxels}
        model = TaxelModel(noise_n, defects=Defects.of(amounts, self.seed))
        signal_n = model.signal(force_n.reshape(-1, side, side), rng, period_s=1e-3)
        return signal_n.reshape(force_n.shape)

    def idle(self) -> npt.NDArray[np.int16] | None:
        """Return what every taxel reads before the touch, counts, shape (ticks, TAXELS): its noise and defects alone.

        A recording has no before: None.
        """
        if self.name.endswith(".npz"):
            return None
        force_n = np.zeros((IDLE_TICKS_SHORT if self.ticks else IDLE_TICKS, TAXELS), np.float32)
        return _counts(self.sensed(force_n, np.random.default_rng([self.seed, 1]), at_rest=True))

    def load(self) -> Scene:
        """Return the scene itself; the last one is kept."""
        return _scene(self)


@lru_cache(maxsize=1)
def _scene(touch: Touch) -> Scene:
    meshes, ticks = Path(touch.meshes) if touch.meshes else None, touch.ticks or TICKS
    poses = _poses(touch.name)
    if touch.name in SLIDES:
        true = trajectory(touch.name, meshes=meshes, steps=touch.ticks or SLIDE_TICKS)
    elif touch.name in FIELDS:
        true = FIELDS[touch.name](ticks, SIDE)
    elif poses is not None:
        true = np.stack([_pressed(poses(tick), meshes) for tick in range(ticks)])
    else:
        felt = _recorded(Path(touch.name), touch.ticks)
        return Scene(felt, felt, _counts(felt), is_recorded=True)
    flat = true.reshape(len(true), TAXELS)
    felt = touch.sensed(flat, np.random.default_rng(touch.seed))
    return Scene(flat, felt, _counts(felt))


def _poses(name: str) -> Poses | None:
    """Return what is where in a scene of objects, None for any other."""
    drawn = _RANDOM.fullmatch(name)
    return random_poses(int(drawn[2]), int(drawn[1])) if drawn else (OWN | POSED).get(name)


def random_touch(number: int, scene_seed: int, meshes: str | None, seed: int) -> Touch:
    """Return the random scene of that number and seed; `seed` is of noise and losses."""
    return Touch(f"random scene {number} of seed {scene_seed}", meshes=meshes, seed=seed)


def _pressed(objects: Iterator[tuple[str, Pose]], meshes: Path | None) -> Force:
    fingertip = ball(0.016)
    named = ((fingertip if name == "fingertip" else spheres_of(name, meshes), pose) for name, pose in objects)
    return press(Grid(), named)


def _counts(felt_n: Force) -> npt.NDArray[np.int16]:
    return to_counts(felt_n, _ARRAY).astype(np.int16)


def _recorded(path: Path, ticks: int | None) -> Force:
    """Return a recording, each frame for `RECORDED_MS`, in the middle of the skin."""
    with np.load(path, allow_pickle=False) as file:
        names = list(file.files)
    wide = read_counts(path, names[:1], (SIDE, SIDE))[0].shape[2]
    beside = names[: max(1, SIDE // wide)]
    played = Recording(read_counts(path, beside, (SIDE, SIDE)), SIDE, SIDE, steps_per_frame=RECORDED_MS)
    length = min(played.frames, RECORDED_FRAMES) * RECORDED_MS
    frames = [played.frame(tick).force_n.ravel() for tick in range(0, min(ticks or length, length), RECORDED_MS)]
    return np.repeat(np.stack(frames), RECORDED_MS, axis=0)


def recordings_in(folder: Path | None) -> list[str]:
    """Return the recordings of a folder, none without one.

    Raises
    ------
    InputError
        If there are none in it.
    """
    if folder is None:
        return []
    found = sorted(str(path) for path in folder.glob("*.npz"))
    if not found:
        raise InputError(f"no recording in '{folder}': expected .npz files, such as S1.npz")
    return found
