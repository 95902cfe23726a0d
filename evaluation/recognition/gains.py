"""Methods beside the paper's, on the same sums: rows and bars."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.result import Row, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def gain_row(what: str, sums: int, *, runs: int, ours: Any, plain: Any, parts: Sequence[float]) -> Row:
    """Return a row: mean accuracy of a method and of the plain one, percent, and the range over `parts`.

    `ours` and `plain` are numbers, or arrays with one for each run.
    """
    return {
        "what": what,
        "sums": sums,
        "runs": runs,
        "ours": round(float(np.mean(ours)), 2),
        "plain": round(float(np.mean(plain)), 2),
        "gain": round(float(np.mean(ours - plain)), 2),
        "least": round(min(parts), 2),
        "most": round(max(parts), 2),
    }


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
