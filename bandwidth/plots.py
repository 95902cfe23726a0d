"""Pictures of a plan: rates for other numbers of buses and widths of sums; time line of one cycle."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from bandwidth.scheme_rates import schemes
from bandwidth.traffic import traffic
from canskin.errors import InputError
from dbc.contract import Contract
from dbc.dictionary import window_s
from shell.output import save_figure
from skin.layout import Layout

_WIRES: Final = {None: "classic CAN", 2_000_000: "FD 2 Mbit/s", 5_000_000: "FD 5 Mbit/s", 8_000_000: "FD 8 Mbit/s"}


def write_plots(contract: Contract, folder: Path) -> list[Path]:
    """Write ``rates.png`` and ``cycle.png`` and return their paths.

    Raises
    ------
    InputError
        If the files cannot be written.
    """
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in (("rates.png", rates_figure(contract.layout)), ("cycle.png", cycle_figure(contract))):
            save_figure(figure, folder / name, dpi=120, bbox_inches="tight")
            written.append(folder / name)
    except OSError as error:
        raise InputError(f"{folder}: cannot write the plots: {error.strerror or error}") from error
    return written


def rates_figure(layout: Layout) -> Figure:
    """Draw the highest SYNC rate against the number of buses, one panel per width of the sums."""
    best: dict[tuple[int, int | None], dict[int, float]] = {}
    for each in schemes(layout):
        if each.what == "sums" and each.fits_node_ids:
            rates = best.setdefault((each.bits, each.data_bitrate), {})
            rates[each.buses] = max(rates.get(each.buses, 0.0), each.max_rate_hz_worst)
    widths = sorted({bits for bits, _ in best}, reverse=True)
    figure = Figure(figsize=(4 * len(widths), 4))
    panels = np.atleast_1d(figure.subplots(1, len(widths), sharey=True))
    for panel, bits in zip(panels, widths, strict=True):
        for rate, name in _WIRES.items():
            line = best[bits, rate]
            panel.plot(sorted(line), [line[buses] for buses in sorted(line)], marker="o", label=name)
        panel.axhline(layout.sync.rate_hz, color="grey", linestyle=":", label=f"{layout.sync.rate_hz:g} Hz")
        panel.set(title=f"{bits}-bit sums", xlabel="buses", yscale="log", xticks=[1, 2, 4])
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("highest SYNC rate with the most stuff bits, Hz")
    panels[-1].legend(fontsize="small")
    return figure


def cycle_figure(contract: Contract) -> Figure:
    """Draw one cycle of every bus, frames with the most stuff bits one after another, coloured by node."""
    buses = contract.layout.bus
    period_ms = contract.layout.sync.period_s * 1e3
    figure = Figure(figsize=(11, 1 + 0.7 * len(buses)))
    panel = figure.subplots()
    for number in range(len(buses)):
        streams = traffic(contract, number)
        took_ms = streams.worst_ns[streams.is_cyclic] * 1e-6
        starts = np.concatenate([[0.0], np.cumsum(took_ms)[:-1]])
        shade = streams.node[streams.is_cyclic] / max(1, buses[number].nodes)
        colours = [
            (0.2, 0.2, 0.2, 1.0) if node == 0 else (0.1, 0.25 + 0.6 * node, 0.9 - 0.6 * node, 1.0) for node in shade
        ]
        panel.broken_barh(
            list(zip(starts, took_ms, strict=True)), (number - 0.35, 0.7), facecolors=colours, edgecolor="white", lw=0.3
        )
    panel.axvline(period_ms, color="black", label="next SYNC")
    panel.axvline(window_s(contract.layout) * 1e3, color="red", linestyle="--", label="window (1007h)")
    panel.set(xlabel="ms after SYNC, frames with the most stuff bits, node 1 first", xlim=(0, None))
    panel.set_yticks(range(len(buses)), [bus.name for bus in buses])
    panel.invert_yaxis()
    panel.legend(loc="upper right", fontsize="small")
    return figure
