"""Plots of recognition: accuracy over size, and confusions."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.observations import OBJECTS
from evaluation.result import Row, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GUESSING_PERCENT: Final = 100 / OBJECTS
#: Confusions below this are not written out.
_LEAST_PERCENT: Final = 1.5


def draw_accuracies(rows: Sequence[Row], key: str, xlabel: str, name_of: Callable[[Row], str]) -> "Figure":
    """Return accuracy over the column `key` on a logarithmic axis, a curve for each name; crosses are the paper's."""
    figure = new_figure(8, 4.8)
    axes = figure.subplots()
    for name in dict.fromkeys(map(name_of, rows)):
        own = sorted((row for row in rows if name_of(row) == name), key=lambda row: float(row[key]))
        x, y = [row[key] for row in own], np.array([row["ours"] for row in own])
        spread = [y - [row["least_draw"] for row in own], [row["most_draw"] for row in own] - y]
        bars = axes.errorbar(x, y, yerr=np.maximum(spread, 0), marker="o", markersize=4, capsize=3, label=name)
        printed = [(row[key], row["paper"]) for row in own if row["paper"] is not None]
        if printed:
            axes.plot(*zip(*printed, strict=True), "x", markersize=9, color=bars.lines[0].get_color())
    ticks = sorted({row[key] for row in rows})
    axes.set(xlabel=xlabel, ylabel="accuracy (%)", ylim=(0, 102), xscale="log")
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.axhline(_GUESSING_PERCENT, linestyle=":", color="grey")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    return figure


def draw_confusions(matrices: Mapping[str, Any], names: Sequence[str]) -> "Figure":
    """Return confusion matrices side by side, percent."""
    figure = new_figure(7.2 * len(matrices), 6.6)
    for axes, (title, matrix) in zip(np.atleast_1d(figure.subplots(1, len(matrices))), matrices.items(), strict=True):
        image = axes.imshow(matrix, cmap="Blues", vmin=0, vmax=100)
        axes.set_xticks(range(len(names)), names, rotation=60, ha="right")
        axes.set_yticks(range(len(names)), names)
        axes.set(title=title, xlabel="said", ylabel="true")
        for (row, column), percent in np.ndenumerate(np.asarray(matrix)):
            if percent >= _LEAST_PERCENT:
                colour = "white" if percent > 50 else "black"
                axes.text(column, row, f"{percent:.0f}", ha="center", va="center", fontsize=7, color=colour)
        figure.colorbar(image, ax=axes, label="%", shrink=0.8)
    return figure
