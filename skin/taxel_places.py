"""Where taxels lie, which of them are measured, and colours, for programs that draw a skin or use it in space.

The frame of a skin: its origin is the middle of the array, x runs along the columns, y down the rows, and z into the
skin, so a touch presses along z. The taxels lie at z = 0.
"""

import math
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import Image
from skin.layout import Layout, Taxels

Forces = npt.NDArray[np.float32]
#: Colour of taxels without valid sums.
GREY: Final = (128, 128, 128)


def places_m(taxels: Taxels) -> npt.NDArray[np.float32]:
    """Return x, y and z of every taxel, row-major, float32, shape (n, 3), metres."""
    x_m, y_m = np.meshgrid(
        (np.arange(taxels.columns) - (taxels.columns - 1) / 2) * taxels.pitch_m,
        (np.arange(taxels.rows) - (taxels.rows - 1) / 2) * taxels.pitch_m,
    )
    return np.stack((x_m.ravel(), y_m.ravel(), np.zeros(taxels.count)), axis=1).astype(np.float32)


def place_m(taxels: Taxels, row: float, column: float) -> tuple[float, float]:
    """Return x and y of a place between taxels, as the centre of a contact, metres."""
    return (column - (taxels.columns - 1) / 2) * taxels.pitch_m, (row - (taxels.rows - 1) / 2) * taxels.pitch_m


def radius_m(taxels: Taxels, count: int) -> float:
    """Return the radius of a disc with the area of `count` taxels, metres."""
    return math.sqrt(count / math.pi) * taxels.pitch_m


class Grid:
    """The images of one skin as arrays."""

    def __init__(self, layout: Layout) -> None:
        self._shape = layout.taxels.rows, layout.taxels.columns
        self._phi = layout.phi()

    def forces_n(self, image: Image) -> Forces:
        """Return the force on every taxel, shape (rows, columns), newtons; of taxels without valid sums estimates."""
        return np.frombuffer(image.pixels, "<f4").reshape(self._shape)

    def valid(self, image: Image) -> npt.NDArray[np.bool_]:
        """Return whether the block of each taxel is valid, shape (rows, columns)."""
        valid: npt.NDArray[np.bool_] = self._phi.of_taxels(np.frombuffer(image.valid, np.bool_))
        return valid.reshape(self._shape)

    def measured_n(self, image: Image) -> Forces:
        """Return the force on every taxel, shape (rows, columns), newtons; NaN where the block is not valid."""
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
