"""Plots of the rivals: error against bits, latency, traffic that noise makes, and the images themselves."""

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from evaluation.findings import Options, Picture, Row
from evaluation.schemes.rival_images import images_figure
from evaluation.schemes.scenes import SLIDES

#: Panels of the curves: mean over these touches.
PANELS: Final = {
    "five slides": SLIDES,
    "golf ball at rest": ("golf ball at rest",),
    "three boxes slapped on": ("three boxes slapped on",),
    "two boxes shaking": ("two boxes shaking",),
}
#: What the latency plot shows beside the rules.
_LATE: Final = ("sums, 16 bits", "sums, 8 bits", "scan, 10 bits", "32 x 32")


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
            "From the sample to the end of its frame: 99th percentile (bar) and worst (dot). Clocks have a bound; "
            "events wait when many taxels change at once, and with a low threshold those of high node-IDs for good.",
            partial(_latencies, measured),
        ),
        Picture(
            "rivals-noise",
            "Bits that an event-triggered skin sends under a sliding golf ball, by threshold and sensor noise. The "
            "grey line is what the sums take, whatever the noise; above the dotted one there is no room.",
            partial(_noise, measured),
        ),
    ]
    if not options.quick:
        found.append(
            Picture(
                "rivals-images",
                "What is in use 15 and 20 ms after three boxes were slapped on, and while a faint box of 2 mN slides. "
                "The sums of the next SYNC come 18 ms after the slap, all at once, their first image still rough; "
                "events fill the image node by node, and see little of the faint box. 0 to 10 mN.",
                images_figure,
            )
        )
    return found


def _curves(measured: list[Row]) -> Figure:
    shown = {name: touches for name, touches in PANELS.items() if _of(measured, touches)} or {
        row["touch"]: (row["touch"],) for row in measured
    }
    styles = _styles(dict.fromkeys(row["contender"] for row in measured if row["rate_hz"] is not None))
    figure = Figure(figsize=(11, 4 * -(-len(shown) // 2)), layout="constrained")
    panels = np.atleast_1d(figure.subplots(-(-len(shown) // 2), 2, squeeze=False).ravel())
    for panel, (name, touches) in zip(panels, shown.items(), strict=False):
        mine = _of(measured, touches)
        for contender, style in styles.items():
            points = sorted(_means(mine, contender))
            panel.plot(*zip(*points, strict=True), style, markersize=5, label=contender)
        for receiver, mark in (("plain", "kx"), ("solved", "k+")):
            rules = dict.fromkeys(
                row["contender"] for row in mine if "threshold_n" in row and row["receiver"] == receiver
            )
            points = [point for rule in rules for point in _means(mine, rule)]
            if points:
                panel.plot(*zip(*points, strict=True), mark, label=f"events, {receiver}")
        _label(panel, name)
    for panel in panels[len(shown) :]:
        panel.set_axis_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="small")
    return figure


def _styles(contenders: Iterable[str]) -> dict[str, str]:
    """Return a colour for each family, its name's first word, and a mark for each member."""
    families: dict[str, list[str]] = {}
    for contender in contenders:
        families.setdefault(contender.split()[0], []).append(contender)
    return {
        member: f"C{colour}{mark}-"
        for colour, members in enumerate(families.values())
        for member, mark in zip(members, "os^vDPX*", strict=False)
    }


def _label(panel: Axes, name: str) -> None:
    panel.set(title=name, xlabel="kbit/s", ylabel="touched taxels, RMS error, mN", xscale="log", yscale="log")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.2, 0.5)))
    panel.grid(alpha=0.3, which="both")


def _of(measured: list[Row], touches: tuple[str, ...]) -> list[Row]:
    return [row for row in measured if row["touch"] in touches and row["touched_error_mn"] is not None]


def _means(rows: list[Row], contender: str) -> Iterator[tuple[float, float]]:
    """Yield mean bits and error over the touches, for every share of the bits."""
    mine = [row for row in rows if row["contender"] == contender]
    for share in sorted({row["share"] for row in mine}):
        points = [(row["kbit_per_s"], row["touched_error_mn"]) for row in mine if row["share"] == share]
        bits, error = np.mean(points, axis=0)
        yield float(bits), float(error)


def _latencies(measured: list[Row]) -> Figure:
    wanted = ("golf-ball", "three boxes slapped on", "two boxes shaking")
    touches = [touch for touch in wanted if any(row["touch"] == touch for row in measured)]
    rules = [row["contender"] for row in measured if row.get("receiver") == "plain" and "threshold_n" in row]
    names = [*_LATE, *dict.fromkeys(rules)]
    figure = Figure(figsize=(11, 1.2 + 0.32 * len(names)), layout="constrained")
    panels = figure.subplots(1, len(touches), sharey=True, squeeze=False)[0]
    for panel, touch in zip(panels, touches, strict=True):
        here = {row["contender"]: row for row in measured if row["touch"] == touch and row["share"] == 1.0}
        mine = [name for name in names if name in here]
        places = range(len(mine))
        panel.barh(places, [here[name]["latency_p99_ms"] for name in mine], color="tab:blue", alpha=0.6)
        panel.plot([here[name]["latency_worst_ms"] for name in mine], places, "o", color="tab:red")
        panel.set(title=touch, xscale="log", xlabel="ms")
        panel.set_yticks(list(places), mine)
        panel.grid(alpha=0.3, axis="x")
    panels[0].invert_yaxis()
    return figure


def _noise(measured: list[Row]) -> Figure:
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    panel = figure.subplots()
    for touch in dict.fromkeys(row["touch"] for row in measured if row["touch"].startswith("golf-ball")):
        rules = [row for row in measured if row["touch"] == touch and row.get("receiver") == "plain"]
        points = sorted((1e3 * row["threshold_n"], row["kbit_per_s"]) for row in rules if row.get("dead_ms") == 1)
        noise = touch.partition("noise ")[2] or "1 mN"
        panel.plot(*zip(*points, strict=True), "o-", label=f"events, noise {noise}")
    ours = next(row["kbit_per_s"] for row in measured if row["contender"] == "sums, 16 bits" and row["share"] == 1.0)
    panel.axhline(ours, color="grey", label="sums, any noise")
    panel.axhline(4000, color="black", linestyle=":", label="four full buses")
    panel.set(xlabel="threshold, mN", ylabel="kbit/s", yscale="log", title="a sliding golf ball")
    panel.grid(alpha=0.3, which="both")
    panel.legend(fontsize="small")
    return figure
