"""Random touches: object, position, rotation, depth and stroke.

Taxel source and training data have this distribution. Each touch has its own seed, so touch number `index` does not
depend on other touches.
"""

import math
from dataclasses import dataclass
from typing import Final, assert_never

import numpy as np

from skin.sources import StrokeKind, object_label
from skin.taxel import NOISE_N
from touch.classification_poses import OFFSETS_M, ROTATIONS_RAD
from touch.contact import FloatArray, Force, Pose, Shell, Skin, Spheres, press, tangents
from touch.objects import spheres_of
from touch.tracks import Track, border_m, track
from touch.trajectory import PAPER_DEPTH_M

#: An object is the label while the largest true force is at least this, twice the standard deviation of the noise.
LABEL_FORCE_N: Final = 2 * NOISE_N
PAUSE_S: Final = 0.4
#: Short compared with the other phases: the sums of a half pressed object are like those of a smaller object.
PRESS_S: Final = 0.2
HOLD_S: Final = 0.6
SLIDE_S: Final = 2.0
LIFT_S: Final = 0.2
#: Time of one touch with the pause before.
SLOT_S: Final = PAUSE_S + PRESS_S + HOLD_S + SLIDE_S + LIFT_S
DEPTH_M: Final = (0.0095, 0.0105)
#: An object too large for the array still moves from the middle by this part of half the array.
LEAST_REACH_RATIO: Final = 0.08
#: As in the paper's trajectory.
SLIDE_SPEED_M_PER_S: Final = 0.045
#: Independent streams of random numbers.
LIVE, TRAINING = 0, 1


@dataclass(frozen=True)
class Stroke:
    """Press, hold, slide in a straight line, and lift, each at constant speed.

    Attributes
    ----------
    start_m, end_m : tuple of float
        Position x, y before and after the slide; on a track, x is the distance along it.
    rotation_rad : float
        Constant during the touch.
    depth_m : float
        Depth from the end of the press to the lift.
    press_s, hold_s, slide_s, lift_s : float
        Duration of each phase.
    track : Track, optional
        Way of the contact along a skin that is no grid.
    """

    start_m: tuple[float, float]
    end_m: tuple[float, float]
    rotation_rad: float
    depth_m: float
    press_s: float
    hold_s: float
    slide_s: float
    lift_s: float
    track: Track | None = None

    @property
    def duration_s(self) -> float:
        """Duration of the contact."""
        return self.press_s + self.hold_s + self.slide_s + self.lift_s

    def pose(self, time_s: float) -> Pose:
        """Return the pose `time_s` after the first touch; outside the stroke the depth is 0."""
        slid = _progress(time_s - self.press_s - self.hold_s, self.slide_s)
        pressed = _progress(time_s, self.press_s)
        lifted = _progress(time_s - self.duration_s + self.lift_s, self.lift_s)
        (x0, y0), (x1, y1) = self.start_m, self.end_m
        pose = Pose(
            x0 + (x1 - x0) * slid,
            y0 + (y1 - y0) * slid,
            self.rotation_rad,
            self.depth_m * min(pressed, 1.0 - lifted),
        )
        return pose if self.track is None else self.track.placed(pose)


@dataclass(frozen=True, eq=False)
class Touch:
    """One object, by its label, and its stroke over the skin."""

    name: str
    spheres: Spheres
    stroke: Stroke

    def force_n(self, skin: Skin, pose: Pose) -> Force:
        """Return the true force at `pose`, float32, shape (rows, columns)."""
        return press(skin, [(self.spheres, pose)])


def random_stream(seed: int, stream: int, index: int) -> np.random.Generator:
    """Return the random numbers of touch number `index` of a stream."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream, index)))


def draw_touch(name: str, skin: Skin, rng: np.random.Generator, kind: StrokeKind = "slide") -> Touch:
    """Return a random touch of the object `name`, of a kind of `skin.sources.StrokeKind`."""
    spheres, label = spheres_of(name), object_label(name)
    match kind:
        case "slide":
            return Touch(label, spheres, _draw_slide(spheres, skin, rng))
        case "press":
            return Touch(label, spheres, _draw_press(skin, rng))
        case _:
            assert_never(kind)


def _draw_slide(spheres: Spheres, skin: Skin, rng: np.random.Generator) -> Stroke:
    """Return a stroke at any place and angle; the contact stays on the skin if the object fits."""
    rotation = float(rng.uniform(0.0, 2.0 * math.pi))
    depth = float(rng.uniform(*DEPTH_M))
    longest = SLIDE_SPEED_M_PER_S * SLIDE_S
    across_m = _across_m(spheres, skin.taxel_radius_m, rotation, depth)
    if isinstance(skin, Shell):
        way = _draw_track(skin, float(across_m.max()), longest, rng)
        start, end = np.zeros(2), np.array((way.length_m, 0.0))
    else:
        way, half = None, np.array(skin.half_extent_m)
        ends = rng.uniform(-1.0, 1.0, (2, 2)) * np.maximum(half - across_m, LEAST_REACH_RATIO * half)
        start, path = ends[0], ends[1] - ends[0]
        end = start + path / max(1.0, float(np.hypot(path[0], path[1])) / longest)
    return Stroke(
        start_m=(float(start[0]), float(start[1])),
        end_m=(float(end[0]), float(end[1])),
        rotation_rad=rotation,
        depth_m=depth,
        press_s=PRESS_S,
        hold_s=HOLD_S,
        slide_s=SLIDE_S,
        lift_s=LIFT_S,
        track=way,
    )


def _draw_press(skin: Skin, rng: np.random.Generator) -> Stroke:
    """Return a press within the offsets and rotations of the paper's classification data, at its depth."""
    x, y = -rng.uniform(OFFSETS_M[0], OFFSETS_M[-1], 2)
    way = None
    if isinstance(skin, Shell):
        surface, middle = skin.surface, int(np.argmax(border_m(skin.surface)))
        to_m = surface.positions_m[middle] + np.array((x, y)) @ tangents(tuple(surface.normals[middle].tolist()))
        way = track(surface, middle, np.zeros(2), to_m, math.hypot(x, y))
        x, y = way.length_m, 0.0
    return Stroke(
        start_m=(float(x), float(y)),
        end_m=(float(x), float(y)),
        rotation_rad=-float(rng.uniform(ROTATIONS_RAD[0], ROTATIONS_RAD[-1])),
        depth_m=PAPER_DEPTH_M,
        press_s=PRESS_S,
        hold_s=HOLD_S + SLIDE_S,
        slide_s=0.0,
        lift_s=LIFT_S,
        track=way,
    )


def _draw_track(skin: Shell, across_m: float, longest_m: float, rng: np.random.Generator) -> Track:
    """Return a way between two places of one island that are `across_m` away from its border if it has such places."""
    surface = skin.surface
    away_m = border_m(surface)
    widest_m = np.zeros(len(away_m))
    np.maximum.at(widest_m, surface.islands, away_m)
    inner = np.flatnonzero(away_m >= np.minimum(across_m, (1 - LEAST_REACH_RATIO) * widest_m[surface.islands]))
    start = int(rng.choice(inner))
    end = int(rng.choice(inner[surface.islands[inner] == surface.islands[start]]))
    offsets_m = rng.uniform(-0.5, 0.5, (2, 2)) * surface.pitch_m
    to_m = surface.positions_m[end] + offsets_m[1] @ tangents(tuple(surface.normals[end].tolist()))
    return track(surface, start, offsets_m[0], to_m, longest_m)


def _across_m(spheres: Spheres, taxel_radius_m: float, rotation_rad: float, depth_m: float) -> FloatArray:
    """Return how far the contact reaches along x and along y on a flat skin."""
    reach = spheres.radii_m + taxel_radius_m
    indent = np.clip(depth_m + spheres.centres_m[:, 2] + spheres.radii_m, 0.0, reach)
    span = np.sqrt(indent * (2.0 * reach - indent))
    cos, sin = math.cos(rotation_rad), math.sin(rotation_rad)
    x, y = spheres.centres_m[:, 0], spheres.centres_m[:, 1]
    across = np.abs(np.stack([cos * x - sin * y, sin * x + cos * y])) + span
    across_m: FloatArray = np.max(across, axis=1, where=indent > 0.0, initial=0.0)
    return across_m


def _progress(elapsed_s: float, duration_s: float) -> float:
    """Return the finished part of a phase, 0 to 1; a phase of duration 0 is finished at once."""
    if elapsed_s >= duration_s:
        return 1.0
    return elapsed_s / duration_s if elapsed_s > 0.0 else 0.0
