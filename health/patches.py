"""The total force and the centre of pressure of each region of a skin."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from canskin.messages import Image
from canskin.sums import doubtful_taxels
from health.snapshot import PatchState
from skin.layout import Layout
from skin.regions import regions_of

#: A force is doubtful if more than this part of the taxels is not measured, or of the force on doubtful taxels.
DOUBT_RATIO: Final = 0.1

#: A region is over its threshold for this time after the last image that was.
OVER_S: Final = 1.0

Floats = npt.NDArray[np.float32]


class Excess(NamedTuple):
    """A force above the threshold of a region: since when, when last, and the largest force, newtons."""

    since_s: float
    last_s: float
    peak_n: float


class Patches:
    """Sums the forces of images by region."""

    def __init__(self, layout: Layout) -> None:
        surface, phi = layout.taxels.surface, layout.phi()
        self._surface, self._regions = surface, regions_of(layout)
        self._inside: Floats = np.stack([each.taxels for each in self._regions]).astype(np.float32)
        self._limited = [number for number, each in enumerate(self._regions) if each.threshold_n is not None]
        rows, columns = np.indices(surface.shape).reshape(2, -1)
        self._places: Floats = np.column_stack((rows, columns, surface.positions_m)).astype(np.float32)
        self._of_blocks: Floats = np.zeros((len(self._regions), phi.blocks), np.float32)
        for number, region in enumerate(self._regions):
            held = np.bincount(phi.block_of_taxel[region.taxels & phi.is_wired], minlength=phi.blocks)
            self._of_blocks[number] = held * phi.has_sums / region.taxels.sum()
        self._over: dict[str, Excess] = {}

    def take(self, image: Image, now_s: float) -> None:
        """Note the regions whose total force is above their threshold in an image that came at `now_s`."""
        if not self._limited or not image.valid_sums:
            return
        total_n = self._inside[self._limited] @ _forces_n(image)
        for region, force_n in zip((self._regions[number] for number in self._limited), total_n.tolist(), strict=True):
            if region.threshold_n is not None and force_n > region.threshold_n:
                over = self._over.get(region.name)
                if over is None or now_s - over.last_s > OVER_S:
                    over = Excess(now_s, now_s, force_n)
                self._over[region.name] = Excess(over.since_s, now_s, max(over.peak_n, force_n))

    def total_n(self, image: Image) -> float | None:
        """Return the force on the whole skin, newtons; None if nothing was measured."""
        return float(_forces_n(image) @ self._inside[0]) if image.valid_sums else None

    def of(self, image: Image, now_s: float, epoch_s: float) -> list[PatchState]:
        """Return the regions in an image; at `now_s`, where `epoch_s` is the wall-clock time of 0."""
        forces_n = _forces_n(image)
        total_n = self._inside @ forces_n
        moments = self._inside @ (forces_n[:, None] * self._places)
        measured = self._of_blocks @ np.frombuffer(image.valid, np.uint8).astype(np.float32)
        doubtful = doubtful_taxels(image, forces_n.size)
        in_doubt_n = np.zeros_like(total_n) if doubtful is None else self._inside @ (forces_n * doubtful)
        is_doubtful = (measured < 1 - DOUBT_RATIO) | (in_doubt_n > DOUBT_RATIO * total_n)
        found = []
        for number, region in enumerate(self._regions):
            patch = PatchState(name=region.name, force_n=None, threshold_n=region.threshold_n)
            if measured[number] and image.valid_sums:
                force_n, in_doubt = float(total_n[number]), bool(is_doubtful[number])
                patch = replace(patch, force_n=force_n, is_doubtful=in_doubt)
                if force_n > 0:
                    patch = self._with_centre(patch, moments[number] / force_n)
            over = self._over.get(region.name)
            if over is not None and now_s - over.last_s <= OVER_S:
                patch = replace(patch, is_over=True, over_since_time_s=epoch_s + over.since_s, peak_n=over.peak_n)
            found.append(patch)
        return found

    def _with_centre(self, patch: PatchState, centre: Floats) -> PatchState:
        row, column, x_m, y_m, z_m = centre.tolist()
        if not self._surface.is_grid:
            apart_m = np.linalg.norm(self._surface.positions_m - centre[2:], axis=1)
            row, column = 0.0, float(apart_m.argmin())
        return replace(patch, row=row, column=column, position_m=(x_m, y_m, z_m))


def _forces_n(image: Image) -> npt.NDArray[np.float64]:
    """Return the forces as numbers whose sums and moments are finite: those of an image may be as large as float32."""
    return np.frombuffer(image.pixels, "<f4").astype(np.float64)
