"""Plots of the tables and figures, as matplotlib figures."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.result import Row, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colour scale of tactile images, newtons (the paper's).
SCALE_N: Final = 0.01
_MARKS: Final = {"haar": "o", "contourlet": "^", "d4": "s", "dct": "D"}
_COLOURS: Final = {"sbhe": "tab:blue", "noiselet": "tab:orange"}


def draw_differences(rows: Sequence[Row]) -> "Figure":
    """Return ours against the paper's, a panel for each basis, with the spread over draws as bars."""
    figure = new_figure(10, 4.8)
    compared = [row for row in rows if row["paper"] is not None and row["basis"] in {"haar", "contourlet"}]
    for place, basis in enumerate(("haar", "contourlet")):
        axes = figure.add_subplot(1, 2, place + 1)
        for matrix, colour in _COLOURS.items():
            group = [row for row in compared if (row["basis"], row["matrix"]) == (basis, matrix)]
            axes.errorbar(
                [row["paper"] for row in group],
                [row["ours"] for row in group],
                yerr=[row["spread"] for row in group],
                fmt=_MARKS[basis],
                color=colour,
                alpha=0.8,
                label=matrix,
            )
        _diagonal(axes)
        axes.set(title=basis, xlabel="the paper's PSNR, dB", ylabel="our PSNR, dB")
        axes.legend()
    return figure


def draw_counts(rows: Sequence[Row]) -> "Figure":
    """Return the counts of Table I: bars for ours, marks for the paper's, a panel for each object."""
    objects = list(dict.fromkeys(row["object"] for row in rows))
    figure = new_figure(11, 3.9)
    for place, name in enumerate(objects):
        axes = figure.add_subplot(1, len(objects), place + 1)
        group = [row for row in rows if row["object"] == name and row["quantity"] == "mean"]
        bases = [row["basis"] for row in group]
        axes.bar(bases, [row["ours"] for row in group], color="tab:blue", alpha=0.6, label="ours")
        axes.plot(bases, [row["paper"] for row in group], "k_", markersize=18, markeredgewidth=2, label="paper")
        axes.set_title(name)
        axes.tick_params(axis="x", rotation=60)
        if place == 0:
            axes.set_ylabel("coefficients above 0.001 N, mean")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_series(series: Mapping[str, npt.NDArray[np.float64]], stride: int) -> "Figure":
    """Return PSNR over time, a line for each name, smoothed for the eye over some 20 ms as the darker line."""
    figure = new_figure(10, 4.2)
    axes = figure.add_subplot()
    for name, values in series.items():
        time_s = np.arange(len(values)) * stride * 1e-3
        (line,) = axes.plot(time_s, values, alpha=0.25, linewidth=0.7)
        width = max(1, 20 // stride)
        smooth = np.convolve(values, np.ones(width) / width, mode="valid")
        axes.plot(time_s[width // 2 :][: smooth.size], smooth, color=line.get_color(), label=name)
    axes.axvline(1.1, color="0.6", linestyle=":", label="press ends, slide begins")
    axes.set(xlabel="time, s", ylabel="PSNR, dB")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def draw_images(images: Mapping[str, npt.NDArray[Any]]) -> "Figure":
    """Return tactile images side by side with one colour scale, 0 to 0.01 N."""
    figure = new_figure(3.2 * len(images) + 0.8, 3.7)
    axes = [figure.add_subplot(1, len(images), place + 1) for place in range(len(images))]
    for panel, (name, image) in zip(axes, images.items(), strict=True):
        shown = panel.imshow(1e3 * image, vmin=0, vmax=1e3 * SCALE_N, cmap="viridis", interpolation="nearest")
        panel.set_title(name, fontsize=10)
        panel.set_axis_off()
    figure.colorbar(shown, ax=axes, label="force, mN", shrink=0.85)
    return figure


def draw_curves(curves: Mapping[str, tuple[Sequence[float], Sequence[float]]], xlabel: str) -> "Figure":
    """Return lines of (x, PSNR) by name, x on a logarithmic scale."""
    figure = new_figure(8, 4.2)
    axes = figure.add_subplot()
    for name, (across, up) in curves.items():
        axes.plot(across, up, marker=".", label=name)
    axes.set(xscale="log", xlabel=xlabel, ylabel="PSNR, dB")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in "25" else "")
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    return figure


def _diagonal(axes: "Axes") -> None:
    low, high = axes.get_xlim()
    axes.plot([low, high], [low, high], color="0.6", linestyle="--", linewidth=1, label="equal")
    axes.grid(alpha=0.3)
