"""Surfaces of rate against quality."""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from evaluation.figure import new_figure
from evaluation.findings import Picture, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def pictures(rows: list[Row], touches: Mapping[str, str]) -> list[Picture]:
    """Return a picture for every kind of touches that was measured; `touches` are the words for each kind."""
    return [
        Picture(
            f"rates-{kind}",
            f"Mean PSNR ({words}), every square the same bus time; below the decibels the rate, the best framed. To "
            "the right fewer bits and to the top fewer sums, both for more rate.",
            partial(_surface, rows, kind),
        )
        for kind, words in touches.items()
    ]


def _surface(rows: list[Row], kind: str) -> "Figure":
    key = f"psnr_{kind}_db"
    wires = list(dict.fromkeys(row["wires"] for row in rows))
    heights = sorted({row["rows_of_32"] for row in rows})
    widths = sorted({row["bits"] for row in rows}, reverse=True)
    figure = new_figure(4 * len(wires), 4)
    panels = figure.subplots(1, len(wires), squeeze=False)[0]
    values = [row[key] for row in rows]
    for panel, name in zip(panels, wires, strict=True):
        surface = np.full((len(heights), len(widths)), np.nan)
        for row in (row for row in rows if row["wires"] == name):
            down, across = heights.index(row["rows_of_32"]), widths.index(row["bits"])
            surface[down, across] = row[key]
            bright = row[key] < (min(values) + max(values)) / 2
            text = f"{row[key]:.1f} dB\n{row['rate_hz']:g} Hz"
            panel.text(across, down, text, ha="center", va="center", color="white" if bright else "black")
            if kind in row["best_for"]:
                panel.plot(across, down, "s", markersize=48, markerfacecolor="none", color="red")
        drawn = panel.imshow(surface, vmin=min(values), vmax=max(values), cmap="viridis", aspect="auto")
        panel.set_xticks(range(len(widths)), [str(bits) for bits in widths])
        panel.set_yticks(range(len(heights)), [str(height) for height in heights])
        panel.set(title=name, xlabel="bits of a sum", ylabel="rows of 32 that are sent")
    figure.colorbar(drawn, ax=panels, label="mean PSNR, dB")
    return figure
