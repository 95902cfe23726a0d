"""A simulated bus whose nodes make their frames anew in each period, until a frame wins the bus."""

from typing import Protocol

import numpy as np

from bus.simulated_bus import SimulatedBus
from dbc.frame import Frames


class Polled(Protocol):
    """The nodes of a bus."""

    def take(self, ended: Frames, unsent: Frames) -> None:
        """Take note of frames of the bus that ended, those of others included, and of own frames that come back."""

    def offer(self, period: int) -> Frames:
        """Return the frames that take part in arbitration from now to the end of period number `period`."""


def poll(bus: SimulatedBus, nodes: Polled, others: Frames, periods: int, period_ns: int) -> Frames:
    """Run a bus, and return all frames in the order of their ends, with these times.

    Parameters
    ----------
    others : array of FRAME
        Frames of other nodes; `time_ns` is the earliest start.
    """
    station, services = bus.attach("nodes"), bus.attach("others", queue_size=len(others) + 1)
    bus.submit(services, others)
    ended = []
    for period in range(periods):
        now_ns = period * period_ns
        ended.append(bus.run_until(now_ns - 1).frames)
        nodes.take(ended[-1], bus.take_back(station))
        bus.submit(station, nodes.offer(period), now_ns)
    ended.append(bus.run_until(periods * period_ns - 1).frames)
    unsent = bus.take_back(station)
    bus.take_back(services)  # only the frame that has begun still ends
    ended.append(bus.run_until().frames)
    nodes.take(np.concatenate(ended[-2:]), unsent)
    return np.concatenate(ended)
