"""Where contacts are, which taxels are measured, and colours, for programs that draw a skin or use it in space."""

import math
from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import Contact, Image
from skin.layout import Layout
from skin.surface import Surface

Forces = npt.NDArray[np.float32]
#: Colour of taxels without valid sums.
GREY: Final = (128, 128, 128)


def contact_place_m(surface: Surface, contact: Contact) -> tuple[float, float, float]:
    """Return the centre of force of a contact, metres; on a grid by its row and column, which old recordings have."""
    if not surface.is_grid:
        return contact.position_m
    x_m, y_m, z_m = surface.positions_m[0].tolist()
    return x_m + contact.column * surface.pitch_m, y_m + contact.row * surface.pitch_m, z_m


def radius_m(surface: Surface, count: int) -> float:
    """Return the radius of a disc with the area of `count` taxels, metres."""
    return math.sqrt(count / math.pi) * surface.pitch_m


def turned_to(directions: npt.ArrayLike, axis: Sequence[float] = (0.0, 0.0, 1.0)) -> npt.NDArray[np.float64]:
    """Return the quaternions x, y, z, w that turn a coordinate axis to directions of length 1, shape (..., 4)."""
    wanted, start = np.asarray(directions, np.float64), np.asarray(axis)
    turns = np.concatenate((np.cross(start, wanted), 1.0 + (wanted @ start)[..., None]), axis=-1)
    turns[turns[..., 3] < 1e-9] = (*np.roll(start, 1), 0.0)  # half a turn, around an axis at a right angle
    return np.asarray(turns / np.linalg.norm(turns, axis=-1, keepdims=True))


#: Points of a cloud of taxels. `force` is an estimate where `valid` is 0.
TAXEL_POINT: Final = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "force", "normal_x", "normal_y", "normal_z")] + [("valid", "u1")],
    align=True,
)


def taxel_points(surface: Surface, forces_n: Forces, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.void]:
    """Return the taxels as points of `TAXEL_POINT`, of the shape of the skin's arrays."""
    points = np.zeros(forces_n.size, TAXEL_POINT)
    points["x"], points["y"], points["z"] = surface.positions_m.T
    points["normal_x"], points["normal_y"], points["normal_z"] = surface.normals.T
    points["force"], points["valid"] = forces_n.ravel(), valid.ravel()
    return points.reshape(surface.shape)


class Grid:
    """The images of one skin as arrays."""

    def __init__(self, layout: Layout) -> None:
        self._shape = layout.taxels.rows, layout.taxels.columns
        self._phi, self._is_masked = layout.phi(), layout.taxels.is_masked

    def forces_n(self, image: Image) -> Forces:
        """Return the force on every taxel, shape (rows, columns), newtons; of taxels without valid sums estimates."""
        return np.frombuffer(image.pixels, "<f4").reshape(self._shape)

    def valid(self, image: Image) -> npt.NDArray[np.bool_]:
        """Return whether each taxel is measured: its block is valid, and it is not masked; shape (rows, columns)."""
        valid: npt.NDArray[np.bool_] = self._phi.of_taxels(np.frombuffer(image.valid, np.bool_)) & ~self._is_masked
        return valid.reshape(self._shape)

    def measured_n(self, image: Image) -> Forces:
        """Return the force on every taxel, shape (rows, columns), newtons; NaN where it is not measured."""
        return np.where(self.valid(image), self.forces_n(image), np.float32(np.nan))


def force_colours(measured_n: Forces, full_n: float) -> npt.NDArray[np.uint8]:
    """Return red, green and blue of each force: viridis from 0 to `full_n`, grey for NaN; shape (..., 3)."""
    share = np.nan_to_num(measured_n) * (255 / full_n)
    found: npt.NDArray[np.uint8] = _viridis()[np.clip(share + 0.5, 0, 255).astype(np.uint8)]
    found[np.isnan(measured_n)] = GREY
    return found


@cache
def _viridis() -> npt.NDArray[np.uint8]:
    """Return the colours of 256 steps, shape (256, 3)."""
    from matplotlib import colormaps

    found: npt.NDArray[np.uint8] = colormaps["viridis"](np.arange(256), bytes=True)[:, :3]
    return found
