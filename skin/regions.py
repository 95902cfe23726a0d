"""The regions of a skin: its parts that have names, a total force and a threshold, and that can be tared alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.calibration_messages import Region as Box
from canskin.errors import InputError, LayoutError
from skin.layout_keys import Layout, Region

#: Name of the whole skin, unless a region of the layout gives it another.
WHOLE: Final = "whole skin"
#: Connected parts of a skin are regions of their own, unless there are more.
MOST_PARTS: Final = 32


@dataclass(frozen=True, eq=False)
class SkinRegion:
    """A region.

    Attributes
    ----------
    name : str
    taxels : array of bool, shape (n,)
        The taxels of the region, row-major.
    threshold_n : float or None
        Total force above which the region is named in a notice.
    """

    name: str
    taxels: npt.NDArray[np.bool_]
    threshold_n: float | None = None


def regions_of(layout: Layout) -> list[SkinRegion]:
    """Return the regions of a skin, the whole skin first.

    The others are those of the layout; where the layout names none, the connected parts of the skin, if there are
    several: ``part0``, ``part1``, in the order of their first taxels.

    Raises
    ------
    LayoutError
        If a region of the layout has no taxel, or is the second that is the whole skin.
    """
    is_there = np.ones(layout.taxels.count, np.bool_)
    is_there[layout.taxels.gaps] = False
    given = layout.region or []
    whole = [each for each in given if each.box is None and each.part is None]
    named = [each for each in given if each not in whole]
    if len(whole) > 1:
        raise LayoutError(f"regions '{whole[0].name}' and '{whole[1].name}' are both the whole skin - at `$.region`")
    if not named:
        parts = len(_parts(layout, is_there))
        named = [Region(name=f"part{part}", part=part) for part in range(parts)] if 1 < parts <= MOST_PARTS else []
    first = SkinRegion(whole[0].name, is_there, whole[0].threshold_n) if whole else SkinRegion(WHOLE, is_there)
    return [first, *(SkinRegion(each.name, _taxels(layout, each, is_there), each.threshold_n) for each in named)]


def taxels_of(layout: Layout, region: Box | str) -> npt.NDArray[np.bool_]:
    """Return the taxels of a box (first row, first column, last row, last column) or of a named region, shape (n,).

    Raises
    ------
    InputError
        If no region has this name.
    """
    if not isinstance(region, str):
        return _in_box(layout, region)
    known = regions_of(layout)
    found = next((each.taxels for each in known if each.name == region), None)
    if found is None:
        names = ", ".join(f"'{each.name}'" for each in known)
        raise InputError(f"no region '{region[:64]}': expected {names}; [[region]] in the layout names more")
    return found


def _taxels(layout: Layout, region: Region, is_there: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    if region.box is not None and region.part is not None:
        raise LayoutError(f"region '{region.name}': expected `box` or `part`, got both - at `$.region`")
    if region.part is not None:
        parts = _parts(layout, is_there)
        if region.part >= len(parts):
            limit = f"expected a part from 0 to {len(parts) - 1}"
            raise LayoutError(f"region '{region.name}': {limit}, got {region.part} - at `$.region`")
        return np.asarray(layout.taxels.surface.islands == parts[region.part], np.bool_)
    box, taxels = region.box or (), layout.taxels
    if len(box) != 4 or not (box[0] <= box[2] < taxels.rows and box[1] <= box[3] < taxels.columns):
        limits = f"rows of 0 to {taxels.rows - 1} and columns of 0 to {taxels.columns - 1}"
        wanted = f"expected first row, first column, last row and last column, {limits}"
        raise LayoutError(f"region '{region.name}': {wanted}, got {list(box)} - at `$.region`")
    found = _in_box(layout, box) & is_there
    if not found.any():
        raise LayoutError(f"region '{region.name}': no taxel is in {list(box)} - at `$.region`")
    return found


def _parts(layout: Layout, is_there: npt.NDArray[np.bool_]) -> list[int]:
    """Return the numbers of the islands that have taxels."""
    if layout.taxels.surface.is_grid and is_there.all():
        return [0]  # no need of SciPy
    return [int(each) for each in np.unique(layout.taxels.surface.islands[is_there])]


def _in_box(layout: Layout, box: Sequence[int]) -> npt.NDArray[np.bool_]:
    chosen = np.zeros((layout.taxels.rows, layout.taxels.columns), np.bool_)
    top, left, bottom, right = box
    chosen[top : bottom + 1, left : right + 1] = True
    return chosen.ravel()
