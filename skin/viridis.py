"""Colours of forces: those of the pictures of the documents."""

from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.taxel_places import Forces

#: Colour of taxels without valid sums.
GREY: Final = (128, 128, 128)


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
