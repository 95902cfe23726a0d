"""Scenes that no scheme and no setting was chosen on: a few by name, and as many as wanted drawn at random."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from touch.contact import Force, Pose
from touch.objects import CATALOGUE
from touch.trajectory import PAPER_DEPTH_M

Poses = Callable[[int], Iterator[tuple[str, Pose]]]

#: Contacts of a random scene; when each begins and how long it takes to press in, ms; how deep, m; part of the contacts
#: that slide, that turn and that tap.
CONTACTS: Final = (1, 4)
BEGIN_MS: Final = (50.0, 600.0)
RISE_MS: Final = (5.0, 400.0)
DEPTH_M: Final = (0.002, 0.012)
SLIDING, TURNING, TAPPING = 0.6, 0.4, 0.3
#: Speeds of slides, m/s, turns, rad/s, and rates of taps, Hz.
SPEED_M_PER_S: Final = (0.02, 0.6)
TURN_RAD_PER_S: Final = (0.2, 6.0)
TAP_HZ: Final = (1.0, 12.0)
#: Middles of contacts stay within this distance of the middle of the skin, along x and y, m: a slide turns back there.
REACH_M: Final = 0.09
#: The whole skin shaken: mean force and swing, N, and their rate; tilt, N, and its rate.
_SHAKE_N, _SWING_N, _SWING_HZ, _TILT_N, _TILT_HZ = 0.006, 0.0045, 9.1, 0.001, 7.3
#: Waves of a texture, and its speed: 0.6 m/s.
_WAVES, _TAXELS_PER_MS = 12, 0.15
#: How long random values stay, ms, and the largest of them, N.
_KEPT_MS, _RANDOM_N = 20, 0.01


def _banana(tick: int) -> Iterator[tuple[str, Pose]]:
    pressed = min(1.0, max(0.0, (tick - 100) / 150))
    gone = max(0, tick - 300)
    yield "banana", Pose(0.03 - 5e-5 * gone, 0.03 - 4e-5 * gone, 2.5e-3 * gone, 0.011 * pressed)


def _can_and_ball(tick: int) -> Iterator[tuple[str, Pose]]:
    pressed = PAPER_DEPTH_M * min(1.0, max(0.0, (tick - 100) / 60))
    angle = 2 * math.pi * 1e-3 * tick
    yield "tuna-can", Pose(-0.05 + 0.04 * math.sin(angle), -0.04, 0.0, pressed)
    yield "golf-ball", Pose(0.05, 0.06 * math.cos(angle), 0.0, pressed)


def _slow_ball(tick: int) -> Iterator[tuple[str, Pose]]:
    yield "racquetball", Pose(0.02, -0.03, 0.0, 4e-6 * max(0, tick - 100))


#: Objects, by scene: what is where at each millisecond.
POSED: Final[dict[str, Poses]] = {
    "banana turning and sliding": _banana,
    "can and ball fast": _can_and_ball,
    "ball pressed slowly": _slow_ball,
}


def _shaken(ticks: int, side: int) -> Force:
    time_s = 1e-3 * np.arange(ticks)[:, None, None]
    tilt = ((np.arange(side) - side / 2) / (side / 2))[:, None]
    swing = _SWING_N * np.sin(2 * np.pi * _SWING_HZ * time_s) + _TILT_N * np.sin(2 * np.pi * _TILT_HZ * time_s) * tilt
    force: Force = np.maximum(np.minimum(1, time_s / 0.3) * (_SHAKE_N + swing), 0).astype(np.float32)
    return np.repeat(force, side, axis=2)


def _texture(ticks: int, side: int) -> Force:
    rng = np.random.default_rng(3)
    phases, waves = rng.uniform(0, 2 * np.pi, _WAVES), rng.normal(0, 0.45, (_WAVES, 2))
    across = np.arange(side) - _TAXELS_PER_MS * np.arange(ticks)[:, None, None]
    height = np.zeros((ticks, side, side), np.float32)
    for phase, (along, down) in zip(phases, waves, strict=True):
        height += np.cos(along * across + down * np.arange(side)[:, None] + phase).astype(np.float32)
    force: Force = np.maximum(np.float32(0.003 / math.sqrt(_WAVES / 2)) * height + np.float32(0.004), 0)
    return force


def _random_values(ticks: int, side: int) -> Force:
    values = np.random.default_rng(4).uniform(0, _RANDOM_N, (-(-ticks // _KEPT_MS), side, side))
    return np.repeat(values.astype(np.float32), _KEPT_MS, axis=0)[:ticks]


#: Forces without objects, by scene: a function of ticks and side, shape (ticks, side, side), newtons.
FIELDS: Final[dict[str, Callable[[int, int], Force]]] = {
    "whole skin shaken": _shaken,
    "texture sliding": _texture,
    "random values every 20 ms": _random_values,
}


@dataclass(frozen=True)
class Contact:
    """One object of a random scene.

    Attributes
    ----------
    name : str
        Of `CATALOGUE`.
    begin_ms, rise_ms : float
        When it touches, and how long it takes to reach its depth.
    depth_m : float
    tap_hz : float
        How often it is lifted and pressed again; 0: never.
    place_m, speed_m_per_s : tuple of float
        Where it touches, and how it slides, along x and y.
    rotation_rad, turn_rad_per_s : float
    """

    name: str
    begin_ms: float
    rise_ms: float
    depth_m: float
    tap_hz: float
    place_m: tuple[float, float]
    speed_m_per_s: tuple[float, float]
    rotation_rad: float
    turn_rad_per_s: float

    def pose(self, tick: int) -> Pose:
        """Return the pose at millisecond `tick`."""
        past_ms = tick - self.begin_ms
        past_s = 1e-3 * max(0.0, past_ms)
        pressed = min(1.0, max(0.0, past_ms / self.rise_ms))
        if self.tap_hz:
            # From 1 down to -1 and back: above the skin for half of the time.
            pressed *= math.cos(2 * math.pi * self.tap_hz * max(0.0, past_s - 1e-3 * self.rise_ms))
        x, y = (_folded(place + speed * past_s) for place, speed in zip(self.place_m, self.speed_m_per_s, strict=True))
        return Pose(x, y, self.rotation_rad + self.turn_rad_per_s * past_s, self.depth_m * pressed)


def random_contacts(seed: int, number: int) -> tuple[Contact, ...]:
    """Return the contacts of a random scene; scenes of one seed differ by their number."""
    rng = np.random.default_rng([seed, number])
    return tuple(_contact(rng) for _ in range(int(rng.integers(CONTACTS[0], CONTACTS[1] + 1))))


def random_poses(seed: int, number: int) -> Poses:
    """Return what is where in a random scene."""
    contacts = random_contacts(seed, number)
    return lambda tick: ((contact.name, contact.pose(tick)) for contact in contacts)


def _contact(rng: np.random.Generator) -> Contact:
    """Draw a contact; every number is drawn, used or not, so that a change of one leaves the others."""
    names = list(CATALOGUE)
    heading, speed = rng.uniform(0, 2 * math.pi), _log_uniform(rng, SPEED_M_PER_S)
    turn, sense, tap_hz = _log_uniform(rng, TURN_RAD_PER_S), rng.choice([-1.0, 1.0]), _log_uniform(rng, TAP_HZ)
    slides, turns, taps = rng.random(3) < (SLIDING, TURNING, TAPPING)
    x, y = rng.uniform(-REACH_M, REACH_M, 2)
    return Contact(
        name=names[int(rng.integers(len(names)))],
        begin_ms=float(rng.uniform(*BEGIN_MS)),
        rise_ms=_log_uniform(rng, RISE_MS),
        depth_m=float(rng.uniform(*DEPTH_M)),
        tap_hz=tap_hz if taps else 0.0,
        place_m=(float(x), float(y)),
        speed_m_per_s=(speed * math.cos(heading), speed * math.sin(heading)) if slides else (0.0, 0.0),
        rotation_rad=float(rng.uniform(0, 2 * math.pi)),
        turn_rad_per_s=float(sense * turn) if turns else 0.0,
    )


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return math.exp(rng.uniform(math.log(ends[0]), math.log(ends[1])))


def _folded(place_m: float) -> float:
    """Return a place within `REACH_M` of 0, for one that would have gone on: turned back at the ends."""
    return abs((place_m - REACH_M) % (4 * REACH_M) - 2 * REACH_M) - REACH_M
