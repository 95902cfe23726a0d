"""A skin in the plane of a picture: a grid as it is, other taxels in their places.

A flat skin is seen at a right angle, a curved skin along the axis of its smallest extent. Taxels that face away from
the viewer are beside the others, as seen from behind: so each taxel is shown.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.surface import Floats, Indices, Surface

#: A taxel is drawn up to this distance from its place, in pitches, and no farther than halfway to the next taxel.
REACH: Final = 0.8
#: A taxel faces away if its normal has more than this part away from the viewer: 6 degrees.
_AWAY: Final = 0.1
#: Distance between the taxels that face the viewer and the others, in pitches.
_BESIDE: Final = 2.0
#: Axes of nearly the same extent: the first is taken.
_AS_LARGE: Final = 0.99


def view_of(surface: Surface) -> Floats:
    """Return how a viewer stands to a skin: unit vectors to the right, down and away from the viewer, shape (3, 3)."""
    if surface.is_grid:
        return np.eye(3)
    centred = surface.positions_m - surface.positions_m.mean(axis=0)
    extent = np.ptp(centred, axis=0)
    least = int(extent.argmin())
    away = np.linalg.svd(centred, full_matrices=False)[2][2] if surface.is_flat else np.eye(3)[least]
    if float((surface.normals @ away).sum()) > 0:
        away = -away
    extent[least] = 0.0
    right = np.eye(3)[int((extent > _AS_LARGE * extent.max()).argmax())]
    right = right - (right @ away) * away
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(away, right), away))


class Plane:
    """The places of taxels in a picture, in pitches: x to the right, y down, from the upper left corner.

    Attributes
    ----------
    places : array, shape (n, 2)
        x and y of each taxel.
    width, height : float
        Of the picture.
    """

    def __init__(self, surface: Surface) -> None:
        self._pitch_m, self._view = surface.pitch_m, view_of(surface)
        #: What is added to x of taxels that face the viewer, and of the others.
        self._starts = [0.0, 0.0]
        self._top = 0.0
        self.width = 0.0
        seen, is_behind = self._seen(surface.positions_m, surface.normals)
        for behind in (False, True):
            x = seen[is_behind == behind, 0]
            if x.size:
                self.width += _BESIDE * (self.width > 0)
                self._starts[behind] = self.width + 0.5 - x.min()
                self.width += float(np.ptp(x)) + 1.0
        self._top = 0.5 - float(seen[:, 1].min())
        self.height = float(np.ptp(seen[:, 1])) + 1.0
        self.places = self.place(surface.positions_m, surface.normals)

    def place(self, position_m: Sequence[float] | Floats, normal: Sequence[float] | Floats) -> Floats:
        """Return x and y of places on the skin with these normals, shape (..., 2)."""
        seen, is_behind = self._seen(np.asarray(position_m), np.asarray(normal))
        x = seen[..., 0] + np.where(is_behind, self._starts[1], self._starts[0])
        return np.stack((x, seen[..., 1] + self._top), axis=-1)

    def cells(self, scale: int) -> Indices:
        """Return the taxel of each pixel, -1 where there is none: the nearest, shape (height, width) times `scale`."""
        from scipy.spatial import cKDTree  # no verb waits for SciPy that has no need of it

        y, x = np.mgrid[: round(scale * self.height), : round(scale * self.width)]
        _, taxel = cKDTree(self.places).query((np.stack((x, y), -1) + 0.5) / scale, distance_upper_bound=REACH)
        return np.where(taxel < len(self.places), taxel, -1).astype(np.intp)

    def picture(self, values: npt.NDArray[np.floating], scale: int) -> Floats:
        """Return a picture of a value of each taxel, NaN where there is none, shape as `cells`."""
        return np.asarray(np.append(values, np.nan)[self.cells(scale)], np.float64)

    def _seen(self, position_m: Floats, normal: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Return x and y before they are moved, and which places face away from the viewer."""
        is_behind = normal @ self._view[2] > _AWAY
        seen = position_m @ self._view[:2].T / self._pitch_m
        return np.stack((np.where(is_behind, -seen[..., 0], seen[..., 0]), seen[..., 1]), -1), is_behind
