"""Tactile images of objects, as characters on a terminal and as picture files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import InputError
from shell.output import save_figure
from touch.contact import Force

#: Force of the darkest shade, about the largest force of the paper's data.
_FULL_N: Final = 0.01
_SHADES: Final = " .:-=+*#%@"
_MOST_COLUMNS: Final = 6
_TO_MN: Final = 1e3


def as_text(force_n: Force) -> str:
    """Return an image as lines of characters, cut to the contact; a line shows two rows of taxels.

    Parameters
    ----------
    force_n : numpy.ndarray
        Shape (rows, columns), newtons; 10 mN and more is the darkest character.
    """
    rows, columns = np.nonzero(force_n)
    if not rows.size:
        return "no contact"
    even = np.pad(force_n, ((0, force_n.shape[0] % 2), (0, 0)))
    pairs = even.reshape(-1, 2, even.shape[1]).max(axis=1)
    cut = pairs[rows.min() // 2 : rows.max() // 2 + 1, columns.min() : columns.max() + 1]
    levels = np.minimum(np.ceil(cut / _FULL_N * (len(_SHADES) - 1)), len(_SHADES) - 1).astype(int)
    return "\n".join("".join(_SHADES[level] for level in line).rstrip() for line in levels)


def save_images(images: Mapping[str, Force], path: Path) -> None:
    """Draw one image per object, all from 0 to 10 mN; the suffix of `path` gives the format."""
    from matplotlib.figure import Figure

    columns = min(len(images), _MOST_COLUMNS)
    rows = -(-len(images) // columns)
    figure = Figure(figsize=(2.1 * columns + 1.0, 2.3 * rows), layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes, (name, force_n) in zip(panels, images.items(), strict=False):
        shown = axes.imshow(force_n * _TO_MN, cmap="viridis", vmin=0.0, vmax=_FULL_N * _TO_MN, interpolation="nearest")
        axes.set_title(name, fontsize=10)
        axes.set(xticks=[], yticks=[])
    for axes in panels[len(images) :]:
        axes.set_axis_off()
    figure.colorbar(shown, ax=panels, label="force, mN", shrink=0.8)
    try:
        save_figure(figure, path, dpi=110)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error}") from error
