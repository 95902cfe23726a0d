"""The picture of a plan: time line of one cycle."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bandwidth.traffic import traffic
from canskin.errors import InputError, reasoned
from dbc.contract import Contract
from dbc.dictionary import window_s
from shell.output import save_figure


def write_plot(contract: Contract, folder: Path) -> Path:
    """Write ``cycle.png`` and return its path; raise InputError if the file cannot be written."""
    path = folder / "cycle.png"
    with reasoned(InputError, f"{folder}: cannot write the plot"):
        folder.mkdir(parents=True, exist_ok=True)
        save_figure(cycle_figure(contract), path, dpi=120, bbox_inches="tight")
    return path


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
