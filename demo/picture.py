"""The picture of a run: true force, one raw sample, rebuilt image, and error."""

from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from demo.score import CycleImages
from shell.output import save_figure
from skin.layout import Taxels
from skin.plane import Plane
from skin.psnr import psnr_db

#: Pixels between neighbours of a skin that is no grid.
_SCALE: Final = 8


def save_picture(images: CycleImages, taxels: Taxels, path: Path, *, noisy: bool = True) -> None:
    """Draw true force, one raw sample of the sensor, rebuilt image and its error side by side.

    Parameters
    ----------
    taxels : Taxels
        Where the forces are: a skin that is no grid is drawn as `skin.plane.Plane` has it. The end of their range is
        the peak of the PSNR.
    path : pathlib.Path
        File with one of `shell.output.PICTURE_SUFFIXES`.
    noisy : bool
        Whether the sensor adds noise; else its PSNR is not shown.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    to_mn, peak_n = 1e3, taxels.force_max_n
    plane, scale = Plane(taxels.surface), 1 if taxels.surface.is_grid else _SCALE
    top = float(images.true.max()) * to_mn
    error = images.image - images.true
    there = taxels.without_gaps
    sensor_db, image_db = (psnr_db(there(images.true), there(each), peak_n) for each in (images.sensor, images.image))
    of_sensor = f", {sensor_db:.1f} dB" if noisy else ", no noise"
    panels = (
        ("true", images.true, "viridis", 0.0, top),
        (f"one raw sample{of_sensor}", images.sensor, "viridis", 0.0, top),
        (f"rebuilt, {image_db:.1f} dB", images.image, "viridis", 0.0, top),
        ("rebuilt minus true", error, "RdBu_r", -top / 4, top / 4),
    )
    figure = Figure(figsize=(13, 3.4), layout="constrained")
    for axis, (title, grid, colours, low, high) in zip(figure.subplots(1, 4), panels, strict=True):
        shown = axis.imshow(
            plane.picture(grid * to_mn, scale), cmap=colours, vmin=low, vmax=high, interpolation="nearest"
        )
        axis.set_title(title, fontsize=10)
        axis.set(xticks=[], yticks=[])
        figure.colorbar(shown, ax=axis, shrink=0.85, label="mN")
    save_figure(figure, path, dpi=110)
