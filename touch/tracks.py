"""Ways of a contact along a skin of any shape.

The way to a place is straight: each step goes along the skin towards the place. The skin between the taxels is where
the planes through the taxels, half along their own normals and half along the mean normal, have the mean 0, near
taxels counting most (moving least squares; Kolluri 2008). This is exact for planes, spheres and cylinders.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from shell.compiled import njit
from skin.surface import Surface
from touch.contact import FloatArray, Pose, Vector, tangents

#: Length of a step of a way, in pitches.
STEP_PITCHES: Final = 1.0
#: Where the sum of the weights exp(-d²/2) of the taxels, d in pitches, is lower, the skin has ended.
_LEAST_WEIGHT: Final = math.exp(-2.0)
#: Square of the distance in pitches at which taxels do not count.
_FAR_SQUARED: Final = 9.0


@dataclass(frozen=True, eq=False)
class Track:
    """A way along a skin.

    Attributes
    ----------
    lines : array, shape (n, 10)
        Of each point its distance along the way, metres; its place; its normal; and the direction along the skin that
        keeps its angle to the way.
    """

    lines: FloatArray

    @property
    def length_m(self) -> float:
        """Length of the way."""
        return float(self.lines[-1, 0])

    def placed(self, pose: Pose) -> Pose:
        """Return the pose on the skin of a pose whose x is the distance along the way."""
        after = int(np.searchsorted(self.lines[1:-1, 0], pose.x_m)) + 1
        before, behind = self.lines[after - 1], self.lines[min(after, len(self.lines) - 1)]
        ratio = (pose.x_m - before[0]) / max(behind[0] - before[0], 1e-12)
        place = before + min(max(ratio, 0.0), 1.0) * (behind - before)
        x, y, z = (place[4:7] / np.linalg.norm(place[4:7])).tolist()
        first, second = tangents((x, y, z))
        turned = math.atan2(place[7:] @ second, place[7:] @ first)
        return Pose(place[1], place[2], pose.rotation_rad + turned, pose.depth_m, place[3], (x, y, z))


def track(surface: Surface, taxel: int, offset_m: FloatArray, to_m: FloatArray, longest_m: float) -> Track:
    """Return the way from a place beside a taxel.

    Parameters
    ----------
    surface : Surface
        The skin.
    taxel : int
    offset_m : array, shape (2,)
        Where the way starts, along the `tangents` of the taxel.
    to_m : array, shape (3,)
        Where it leads to: it ends where that is straight below or above, where the skin ends, or after `longest_m`.
    """
    normal: Vector = tuple(surface.normals[taxel].tolist())
    axes = np.array(tangents(normal))
    step_m = STEP_PITCHES * surface.pitch_m
    lines = np.empty((int(longest_m / step_m) + 2, 10))
    lines[0, 0], lines[0, 1:4] = 0.0, surface.positions_m[taxel] + offset_m @ axes
    lines[0, 4:7], lines[0, 7:] = normal, axes[0]
    taxels = surface.positions_m, surface.normals, surface.pitch_m
    count = _walk(taxels, np.asarray(to_m, np.float64), longest_m, lines)
    return Track(lines[:count])


@lru_cache(maxsize=4)
def border_m(surface: Surface) -> FloatArray:
    """Return the distance of each taxel from the border of the skin along the edges; infinite where none is."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    count = len(surface.positions_m)
    both = np.concatenate((surface.edges, surface.edges[:, ::-1]))
    lengths = np.linalg.norm(surface.positions_m[both[:, 1]] - surface.positions_m[both[:, 0]], axis=1)
    border = np.flatnonzero(surface.is_border)
    if not border.size:
        return np.full(count, np.inf)
    graph = coo_array((lengths, (both[:, 0], both[:, 1])), shape=(count, count)).tocsr()
    found: FloatArray = dijkstra(graph, indices=border, min_only=True) + surface.pitch_m / 2
    return found


def _walk_along(taxels: tuple[FloatArray, FloatArray, float], to: FloatArray, longest: float, lines: FloatArray) -> int:
    """Fill in the lines of a track after the first, and put the first on the skin; return their number."""
    positions, normals, pitch = taxels
    step = STEP_PITCHES * pitch
    at, normal, kept = lines[0, 1:4].copy(), lines[0, 4:7].copy(), lines[0, 7:].copy()
    count, done = 0, 0.0
    while True:
        total, own = 0.0, 0.0
        mean, shift = np.zeros(3), np.zeros(3)
        x, y, z = at
        out_x, out_y, out_z = normal
        for taxel in range(len(positions)):
            dx, dy, dz = positions[taxel, 0] - x, positions[taxel, 1] - y, positions[taxel, 2] - z
            squared = (dx * dx + dy * dy + dz * dz) / (pitch * pitch)
            if squared > _FAR_SQUARED:
                continue
            nx, ny, nz = normals[taxel]
            if nx * out_x + ny * out_y + nz * out_z <= 0.0:
                continue
            weight = math.exp(-0.5 * squared)
            total += weight
            own += weight * (dx * nx + dy * ny + dz * nz)
            for axis in range(3):
                mean[axis] += weight * normals[taxel, axis]
                shift[axis] += weight * (positions[taxel, axis] - at[axis])
        if total < _LEAST_WEIGHT:
            return max(count, 1)
        normal = mean / math.sqrt(mean @ mean)
        at = at + 0.5 * (shift @ normal + own) / total * normal
        kept = kept - (kept @ normal) * normal
        kept /= math.sqrt(kept @ kept)
        lines[count, 0] = done
        lines[count, 1:4], lines[count, 4:7], lines[count, 7:] = at, normal, kept
        count += 1
        ahead = to - at
        ahead = ahead - (ahead @ normal) * normal
        left = math.sqrt(ahead @ ahead)
        length = min(step, left, longest - done)
        if length <= 1e-6 * pitch or count == len(lines):
            return count
        at = at + (length / left) * ahead
        done += length


_walk: Callable[..., int] = njit(cache=True)(_walk_along)
