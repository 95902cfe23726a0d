"""Simple bodies of spheres; only the side that can touch the array is built.

The sizes of the spheres are those of BubbleTouch's own models: 1.5 mm for boxes, 5 mm for cans.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from touch.contact import FloatArray, Spheres

BOX_SPHERE_M: Final = 0.0015
BOX_SPACING_M: Final = 0.0015
CAN_SPHERE_M: Final = 0.005
#: Distance of the spheres in a lid, half a taxel's pitch: the lid is flat to 0.15 mm.
CAN_SPACING_M: Final = 0.002
RIM_SPACING_M: Final = 0.001
ROD_SPACING_M: Final = 0.002

#: Rows of numbers, metres; see the functions.
Knots = Sequence[Sequence[float]] | FloatArray


def ball(diameter_m: float) -> Spheres:
    """Return a ball: one sphere."""
    return Spheres(np.zeros((1, 3)), np.array([diameter_m / 2]))


def box(length_m: float, width_m: float) -> Spheres:
    """Return the top face of a box with exact outer size, length along x.

    Spheres further down the sides would lie below the spheres of the edge and never touch first.
    """
    x, y = np.meshgrid(_spread(length_m), _spread(width_m))
    return _flat(x.ravel(), y.ravel(), BOX_SPHERE_M)


def can(diameter_m: float) -> Spheres:
    """Return the flat lid of a can: rings of spheres, the outermost one ending at the diameter."""
    outer = diameter_m / 2 - CAN_SPHERE_M
    count = max(2, math.ceil(outer / CAN_SPACING_M) + 1)
    rings = [_circle(radius, CAN_SPACING_M) for radius in np.linspace(0.0, outer, count)]
    x, y = np.concatenate(rings, axis=1)
    return _flat(x, y, CAN_SPHERE_M)


def ring(diameter_m: float, wall_m: float) -> Spheres:
    """Return the open rim of a cup: one circle of spheres of diameter `wall_m`."""
    x, y = _circle((diameter_m - wall_m) / 2, RIM_SPACING_M)
    return _flat(x, y, wall_m / 2)


def rods(parts: Sequence[Knots]) -> Spheres:
    """Return bent rods of varying width: spheres from knot to knot, with linear position and radius.

    Parameters
    ----------
    parts : sequence of Knots
        For each rod, x, y, height of the top and radius of each knot, metres. A rod of one knot is a ball.
    """
    spheres = np.concatenate([_rod(np.array(knots, np.float64).reshape(-1, 4)) for knots in parts])
    x, y, top, radii = spheres.T
    return Spheres(np.stack([x, y, top - radii], axis=1), radii)


def rim(circles: Knots, middle_m: tuple[float, float] = (0.0, 0.0), slope: tuple[float, float] = (0.0, 0.0)) -> Spheres:
    """Return the rim of a cup with a rounded lip: concentric circles of spheres.

    Parameters
    ----------
    circles : Knots
        Radius, height of the top, and radius of the spheres of each circle, metres.
    middle_m : tuple of float
        Middle x, y.
    slope : tuple of float
        Slope of the rim along x and along y.
    """
    parts = []
    for circle_m, top_m, radius_m in circles:
        x, y = _circle(circle_m, RIM_SPACING_M)
        z = top_m - radius_m + slope[0] * x + slope[1] * y
        parts.append(np.stack([x + middle_m[0], y + middle_m[1], z, np.full_like(x, radius_m)]))
    x, y, z, radii = np.concatenate(parts, axis=1)
    return Spheres(np.stack([x, y, z], axis=1), radii)


def _spread(length_m: float) -> FloatArray:
    half = length_m / 2 - BOX_SPHERE_M
    return np.linspace(-half, half, max(2, math.ceil(2 * half / BOX_SPACING_M) + 1))


def _circle(radius_m: float, spacing_m: float) -> FloatArray:
    count = max(1, math.ceil(2 * math.pi * radius_m / spacing_m))
    angle = 2 * math.pi * np.arange(count) / count
    return radius_m * np.stack([np.cos(angle), np.sin(angle)])


def _rod(knots: FloatArray) -> FloatArray:
    """Return spheres (x, y, top, radius) from knot to knot, shape (n, 4)."""
    parts = [knots[:1]]
    for near, far in itertools.pairwise(knots):
        count = max(1, math.ceil(math.dist(near[:2], far[:2]) / ROD_SPACING_M))
        parts.append(near + (far - near) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(parts)


def _flat(x: FloatArray, y: FloatArray, radius_m: float) -> Spheres:
    return Spheres(np.stack([x, y, np.zeros_like(x)], axis=1), np.full(x.size, radius_m))
