"""Plots of recognition: accuracy over size, confusion."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.figure import new_figure
from evaluation.findings import Row
from evaluation.observations.signals import OBJECTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GUESSING_PERCENT: Final = 100 / OBJECTS
#: Confusions below this are not written out.
_LEAST_PERCENT: Final = 1.5


def draw_sizes(rows: Sequence[Row]) -> "Figure":
    """Return accuracy over signal size."""
    figure, axes = _axes("signal size (values per observation)", "accuracy (%)")
    _curves(axes, rows, "size", lambda row: str(row["signal"]))
    axes.set_xscale("log", base=2)
    ticks = sorted({row["size"] for row in rows})
    axes.set_xticks(ticks, [str(size) for size in ticks])
    return figure


def draw_training(rows: Sequence[Row]) -> "Figure":
    """Return accuracy over training size."""
    figure, axes = _axes("training size (% of the perturbations)", "accuracy (%)")
    _curves(axes, rows, "training_percent", lambda row: f"{row['signal']}, {row['size']}")
    axes.set_xscale("log")
    ticks = sorted({row["training_percent"] for row in rows})
    axes.set_xticks(ticks, [f"{percent:g}" for percent in ticks])
    axes.minorticks_off()
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


def _axes(across: str, up: str) -> "tuple[Figure, Axes]":
    figure = new_figure(8, 4.8)
    axes = figure.subplots()
    axes.set(xlabel=across, ylabel=up, ylim=(0, 102))
    axes.axhline(_GUESSING_PERCENT, linestyle=":", color="grey")
    axes.grid(alpha=0.3)
    return figure, axes


def _curves(axes: "Axes", rows: Sequence[Row], key: str, name_of: Any) -> None:
    for name in dict.fromkeys(name_of(row) for row in rows):
        own = sorted((row for row in rows if name_of(row) == name), key=lambda row: float(row[key]))
        x, y = [row[key] for row in own], np.array([row["ours"] for row in own])
        spread = [y - [row["least_draw"] for row in own], [row["most_draw"] for row in own] - y]
        bars = axes.errorbar(x, y, yerr=np.maximum(spread, 0), marker="o", markersize=4, capsize=3, label=name)
        told = [(row[key], row["paper"]) for row in own if row["paper"] is not None]
        if told:
            axes.plot(*zip(*told, strict=True), "x", markersize=9, color=bars.lines[0].get_color())
    axes.legend(loc="lower right")


def draw_gains(rows: Sequence[Row]) -> "Figure":
    """Return every method's accuracy as bars, one panel for each number of sums."""
    sizes = list(dict.fromkeys(row["sums"] for row in rows))
    tallest = max(sum(row["sums"] == size for row in rows) for size in sizes)
    figure = new_figure(5.2 * len(sizes) + 2, 0.32 * tallest + 1.4)
    for axes, size in zip(np.atleast_1d(figure.subplots(1, len(sizes))), sizes, strict=True):
        own = [row for row in rows if row["sums"] == size][::-1]
        ours = np.array([row["ours"] for row in own])
        whiskers = [ours - [row["least"] for row in own], [row["most"] for row in own] - ours]
        axes.barh(range(len(own)), ours, xerr=np.maximum(whiskers, 0), color="tab:blue", alpha=0.7)
        axes.axvline(own[0]["plain"], linestyle=":", color="black")
        axes.set_yticks(range(len(own)), [row["what"] for row in own])
        axes.set(title=f"{size} sums", xlabel="accuracy (%)", xlim=(max(0, ours.min() - 15), 100))
    return figure
