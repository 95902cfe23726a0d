"""The highest rate at which a layout fits its buses: load and window."""

from dataclasses import replace
from typing import Final

from bandwidth.plan import bus_time
from bandwidth.traffic import Disturbance, traffic
from dbc.contract import Contract
from dbc.dictionary import window_s
from skin.choice import ROOM
from skin.layout import RATE_MAX_HZ, Layout, changed, validated

#: Resolution of the search.
STEP_HZ: Final = 0.5


def highest_rate_hz(layout: Layout, budget: float = ROOM, allowed: Disturbance | None = None) -> float:
    """Return the highest SYNC rate, in steps of `STEP_HZ`, at which every bus keeps `budget` and window.

    Parameters
    ----------
    layout : Layout
        The rate of this layout has no effect.
    budget : float
        Highest load of a bus, with the most stuff bits, as a part of 1.
    allowed : Disturbance, optional
        Disturbances that response times include.

    Returns
    -------
    float
        0 if even the lowest rate does not fit.
    """
    allowed = allowed or Disturbance()
    contract = Contract.from_layout(validated(layout))
    buses = range(len(layout.bus))
    most_hz = min(bus_time(traffic(contract, bus, allowed=allowed), "worst").rate_hz(budget) for bus in buses)
    low, high = 0, int(min(most_hz, RATE_MAX_HZ) / STEP_HZ)
    while low < high:
        middle = (low + high + 1) // 2
        faster = replace(contract, layout=changed(contract.layout, sync={"rate_hz": middle * STEP_HZ}))
        if all(_keeps_window(faster, bus, allowed) for bus in buses):
            low = middle
        else:
            high = middle - 1
    return low * STEP_HZ


def _keeps_window(contract: Contract, bus: int, allowed: Disturbance) -> bool:
    streams = traffic(contract, bus, allowed=allowed)
    needed_ns = int(streams.responses_ns(allowed.errors_per_s)[streams.is_tpdo].max(initial=0))
    return needed_ns <= window_s(contract.layout) * 1e9
