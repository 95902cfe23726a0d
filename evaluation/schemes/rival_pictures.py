"""Plots of the rivals: error against bits, latency, traffic that noise makes, and the images themselves."""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.figure import new_figure
from evaluation.findings import Options, Picture, Row
from evaluation.schemes.contenders import Scan, Sums
from evaluation.schemes.rival_images import caption, images_figure
from evaluation.schemes.rival_notes import OURS
from evaluation.schemes.scenes import SLIDES
from skin.layout import load_layout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Panels of the curves: mean over these touches.
PANELS: Final = {
    "five slides": SLIDES,
    "golf ball at rest": ("golf ball at rest",),
    "three boxes slapped on": ("three boxes slapped on",),
    "two boxes shaking": ("two boxes shaking",),
}
#: What the latency plot shows beside the rules.
_LATE: Final = (Sums(16), Sums(8), Scan(64, 10), Scan(32, 10))
#: Touches of the latency plot, and the one of the noise plot.
_LATE_TOUCHES: Final = ("golf-ball", "three boxes slapped on", "two boxes shaking")
_NOISE_TOUCH: Final = "golf-ball"


def pictures(measured: list[Row], options: Options) -> list[Picture]:
    """Return the plots of what was measured."""
    found = [
        Picture(
            "rivals-curves",
            "Error where the skin is touched against bits a second of all four buses, both logarithmic: lower and "
            "further left is better. Every point of an event-triggered skin is one rule; its bits follow the touch.",
            partial(_curves, measured),
        ),
        Picture(
            "rivals-latency",
            "From the sample to the end of its frame: 99th percentile (bar) and worst (dot), logarithmic. A "
            "change that was never sent counts with the time it waited.",
            partial(_latencies, measured),
        ),
        Picture(
            "rivals-noise",
            "Bits that an event-triggered skin sends under a sliding golf ball, by threshold and sensor noise. The "
            "grey line is what the sums take; above the dotted one there is no room.",
            partial(_noise, measured),
        ),
    ]
    if not options.quick:
        found.append(
            Picture(
                "rivals-images",
                caption(),
                images_figure,
            )
        )
    return found


def _curves(measured: list[Row]) -> "Figure":
    shown = {name: touches for name, touches in PANELS.items() if _of(measured, touches)} or {
        name: (name,) for name in dict.fromkeys(row["touch"].name for row in measured)
    }
    styles = _styles(measured)
    figure = new_figure(11, 4 * -(-len(shown) // 2))
    panels = np.atleast_1d(figure.subplots(-(-len(shown) // 2), 2, squeeze=False).ravel())
    for panel, (name, touches) in zip(panels, shown.items(), strict=False):
        mine = _of(measured, touches)
        for contender, style in styles.items():
            points = sorted(_means(mine, contender))
            panel.plot(*zip(*points, strict=True), style, markersize=5, label=contender)
        for receiver, mark in (("plain", "kx"), ("solved", "k+")):
            rules = dict.fromkeys(
                row["name"] for row in mine if row["family"] == "events" and row["receiver"] == receiver
            )
            points = [point for rule in rules for point in _means(mine, rule)]
            if points:
                panel.plot(*zip(*points, strict=True), mark, label=f"events, {receiver}")
        _label(panel, name)
    for panel in panels[len(shown) :]:
        panel.set_axis_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="small")
    return figure


def _styles(measured: list[Row]) -> dict[str, str]:
    """Return for all who go by the clock a colour for each family and a mark for each member."""
    families: dict[str, dict[str, None]] = {}
    for row in measured:
        if row["family"] != "events":
            families.setdefault(row["family"], {})[row["name"]] = None
    return {
        member: f"C{colour}{mark}-"
        for colour, members in enumerate(families.values())
        for member, mark in zip(members, "os^vDPX*", strict=False)
    }


def _label(panel: "Axes", name: str) -> None:
    from matplotlib.ticker import LogFormatter

    panel.set(title=name, xlabel="kbit/s", ylabel="touched taxels, RMS error, mN", xscale="log", yscale="log")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.2, 0.5)))
    panel.grid(alpha=0.3, which="both")


def _of(measured: list[Row], touches: tuple[str, ...]) -> list[Row]:
    """Return the rows of touches of these names at the paper's noise, nothing lost, where something is touched."""
    return [
        row
        for row in measured
        if row["touch"].name in touches and row["touch"].is_plain and row["touched_error_mn"] is not None
    ]


def _means(rows: list[Row], name: str) -> Iterator[tuple[float, float]]:
    """Yield mean bits and error over the touches, for every share of the bits."""
    mine = [row for row in rows if row["name"] == name]
    for share in sorted({row["share"] for row in mine}):
        points = [(row["kbit_per_s"], row["touched_error_mn"]) for row in mine if row["share"] == share]
        bits, error = np.mean(points, axis=0)
        yield float(bits), float(error)


def _latencies(measured: list[Row]) -> "Figure":
    plain = [row for row in measured if row["touch"].is_plain and row["share"] == 1.0]
    touches = [name for name in _LATE_TOUCHES if any(row["touch"].name == name for row in plain)]
    rules = [row["name"] for row in plain if row["family"] == "events" and row["receiver"] == "plain"]
    names = [*(each.name for each in _LATE), *dict.fromkeys(rules)]
    figure = new_figure(11, 1.2 + 0.32 * len(names))
    panels = figure.subplots(1, len(touches), sharey=True, squeeze=False)[0]
    for panel, touch in zip(panels, touches, strict=True):
        here = {row["name"]: row for row in plain if row["touch"].name == touch}
        mine = [name for name in names if name in here]
        places = range(len(mine))
        panel.barh(places, [here[name]["latency_p99_ms"] for name in mine], color="tab:blue", alpha=0.6)
        panel.plot([here[name]["latency_worst_ms"] for name in mine], places, "o", color="tab:red")
        panel.set(title=touch, xscale="log", xlabel="ms")
        panel.set_yticks(list(places), mine)
        panel.grid(alpha=0.3, axis="x")
    panels[0].invert_yaxis()
    return figure


def _noise(measured: list[Row]) -> "Figure":
    figure = new_figure(8, 4.5)
    panel = figure.subplots()
    mine = [row for row in measured if row["touch"].name == _NOISE_TOUCH]
    for noise_n in dict.fromkeys(row["touch"].noise_n for row in mine):
        rules = [row for row in mine if row["family"] == "events" and row["receiver"] == "plain"]
        points = sorted(
            (1e3 * row["contender"].threshold_n, row["kbit_per_s"])
            for row in rules
            if row["contender"].dead_ms == 1 and row["touch"].noise_n == noise_n
        )
        panel.plot(*zip(*points, strict=True), "o-", label=f"events, noise {1e3 * noise_n:g} mN")
    ours = next(row["kbit_per_s"] for row in mine if row["contender"] == OURS and row["share"] == 1.0)
    buses = load_layout().bus
    panel.axhline(ours, color="grey", label=OURS.name)
    panel.axhline(
        sum(bus.bitrate for bus in buses) / 1e3, color="black", linestyle=":", label=f"{len(buses)} full buses"
    )
    panel.set(xlabel="threshold, mN", ylabel="kbit/s", yscale="log", title=f"sliding {_NOISE_TOUCH}")
    panel.grid(alpha=0.3, which="both")
    panel.legend(fontsize="small")
    return figure
