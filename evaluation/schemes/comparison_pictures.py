"""Plots of the schemes: error against bits, latency, traffic that noise makes, and the images themselves."""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.psnr import psnr_db
from evaluation.result import Options, Picture, Row, new_figure
from evaluation.schemes.judge import Updates
from evaluation.schemes.scenes import SHAKING, SIDE, SLAP, SLAP_MS, SLIDES, TAXELS, Touch
from evaluation.schemes.schemes import Events, Scan, Scheme, Sums
from evaluation.schemes.wire import TICK_NS
from skin.layout import load_layout
from touch.contact import Force

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The default skin.
OURS: Final = Sums(16)
#: Panels of the curves: mean over these touches.
PANELS: Final = {"five slides": SLIDES} | {name: (name,) for name in ("golf ball at rest", SLAP, SHAKING)}
#: What the latency plot shows beside the rules, and on which touches; the touch of the noise plot.
_LATE: Final = (OURS, Sums(8), Scan(64, 10), Scan(32, 10))
_LATE_TOUCHES: Final = ("golf-ball", SLAP, SHAKING)
_NOISE_TOUCH: Final = "golf-ball"
#: Touches and instants of the images, milliseconds from their beginning, and the schemes.
INSTANTS: Final = ((SLAP, SLAP_MS + 15), (SLAP, SLAP_MS + 25), ("faint box", 700))
_SHOWN: Final[tuple[Scheme, ...]] = (OURS, Scan(64, 10), Scan(32, 10, "solved"), Events(4e-3, 1))
SCALE_MN: Final = 10.0
#: Families whose members differ by rules that are tried, and how the rules are marked, by receiver.
EVENT_FAMILIES: Final = ("events", "filtered events")
_MARKS: Final = (
    ("events", "plain", "kx"),
    ("events", "solved", "k+"),
    ("filtered events", "plain", "rx"),
    ("filtered events", "solved", "r+"),
)


def pictures(measured: list[Row], options: Options) -> list[Picture]:
    """Return the plots of what was measured; a quick look has no images."""
    found = [
        Picture(
            "Error where the skin is touched against bits a second of all four buses, both logarithmic: lower and "
            "further left is better. Every point of an event-triggered skin is one rule; its bits follow the touch.",
            partial(_curves, measured),
        ),
        Picture(
            "From the sample to the end of its frame: 99th percentile (bar) and worst (dot), logarithmic. A "
            "change that was never sent counts with the time it waited.",
            partial(_latencies, measured),
        ),
        Picture(
            "Bits that an event-triggered skin sends under a sliding golf ball, by threshold and sensor noise. The "
            "grey line is what the sums take, the dotted line what the buses carry.",
            partial(_noise, measured),
        ),
        Picture(
            f"What is in use {INSTANTS[0][1] - SLAP_MS} and {INSTANTS[1][1] - SLAP_MS} ms after three boxes were "
            f"slapped on, and while a faint box slides, with the PSNR of each image. 0 to {SCALE_MN:g} mN.",
            images_figure,
        ),
    ]
    return found[:-1] if options.quick else found


def _curves(measured: list[Row]) -> "Figure":
    shown = {name: touches for name, touches in PANELS.items() if _of(measured, touches)} or {
        name: (name,) for name in dict.fromkeys(row["touch"].name for row in measured)
    }
    styles = _styles(measured)
    figure = new_figure(11, 4 * -(-len(shown) // 2))
    panels = np.atleast_1d(figure.subplots(-(-len(shown) // 2), 2, squeeze=False).ravel())
    for panel, (name, touches) in zip(panels, shown.items(), strict=False):
        mine = _of(measured, touches)
        for scheme, style in styles.items():
            points = sorted(_means(mine, scheme))
            panel.plot(*zip(*points, strict=True), style, markersize=5, label=scheme)
        for family, receiver, mark in _MARKS:
            rules = dict.fromkeys(row["name"] for row in _events(mine, receiver, family))
            points = [point for rule in rules for point in _means(mine, rule)]
            if points:
                panel.plot(*zip(*points, strict=True), mark, label=f"{family}, {receiver}")
        _label(panel, name)
    for panel in panels[len(shown) :]:
        panel.set_axis_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="small")
    return figure


def _styles(measured: list[Row]) -> dict[str, str]:
    """Return for every scheme that sends by the clock a colour for its family and a mark of its own."""
    families: dict[str, dict[str, None]] = {}
    for row in measured:
        if row["family"] not in EVENT_FAMILIES:
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


def _events(rows: list[Row], receiver: str, family: str = "events") -> list[Row]:
    return [row for row in rows if row["family"] == family and row["receiver"] == receiver]


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
    names = [*(each.name for each in _LATE), *dict.fromkeys(row["name"] for row in _events(plain, "plain"))]
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
        points = sorted(
            (1e3 * row["scheme"].threshold_n, row["kbit_per_s"])
            for row in _events(mine, "plain")
            if row["scheme"].dead_ms == 1 and row["touch"].noise_n == noise_n
        )
        panel.plot(*zip(*points, strict=True), "o-", label=f"events, noise {1e3 * noise_n:g} mN")
    ours = next(row["kbit_per_s"] for row in mine if row["scheme"] == OURS and row["share"] == 1.0)
    buses = load_layout().bus
    full = sum(bus.bitrate for bus in buses) / 1e3
    panel.axhline(ours, color="grey", label=OURS.name)
    panel.axhline(full, color="black", linestyle=":", label=f"{len(buses)} full buses")
    panel.set(xlabel="threshold, mN", ylabel="kbit/s", yscale="log", title=f"sliding {_NOISE_TOUCH}")
    panel.grid(alpha=0.3, which="both")
    panel.legend(fontsize="small")
    return figure


def images_figure() -> "Figure":
    """Draw truth and schemes side by side."""
    figure = new_figure(12, 2.7 * len(INSTANTS))
    panels = figure.subplots(len(INSTANTS), 1 + len(_SHOWN), squeeze=False)
    for row, (name, tick) in zip(panels, INSTANTS, strict=True):
        touch = Touch(name)
        true = touch.load().true_n[tick]
        _draw(row[0], f"{name},\n{tick} ms: truth", true)
        for panel, scheme in zip(row[1:], _SHOWN, strict=True):
            image = in_use(scheme, touch, tick)
            drawn = _draw(panel, f"{scheme.name}\n{psnr_db(true, image):.1f} dB", image)
    figure.colorbar(drawn, ax=panels, label="mN", shrink=0.7)
    return figure


def _draw(panel: Any, title: str, force_n: Force) -> Any:
    panel.set_title(title, fontsize="small")
    panel.set_axis_off()
    return panel.imshow(1e3 * force_n.reshape(SIDE, SIDE), vmin=0, vmax=SCALE_MN, cmap="viridis")


def in_use(scheme: Scheme, touch: Touch, tick: int) -> Force:
    """Return what a scheme has in use at a millisecond, newtons, shape (TAXELS,)."""
    shown, now_ns = scheme.show(touch, 1.0).images, np.array([tick * TICK_NS])
    images = shown.held(now_ns, TAXELS) if isinstance(shown, Updates) else shown
    used = int(images.used(now_ns)[0])
    force_n: Force = images.force_n[used] if used >= 0 else np.zeros(TAXELS, np.float32)
    return force_n
