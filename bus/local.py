"""The link to a bus that the same process serves: frames are handed over, without a socket."""

import time
from typing import Final, Self

import numpy as np

from bus.error_frames import State
from bus.protocol import check_frames, padded
from bus.session import Backlog, Batch
from bus.simulated_bus import SimulatedBus
from dbc.frame import Frames, frames


class LocalLink:
    """A station of a bus of `bus.server.BusServer` in its own process: a `bus.link.Link`.

    The server gives it frames in its turns; it is used by the thread of these turns.

    Parameters
    ----------
    name : str
        Faults select the station by it.
    queue_size : int
        Number of frames in the transmit queue of each controller.
    joined : list of LocalLink
        Those that the server gives frames to: this link is one of them until it is closed.
    """

    proves_echo: Final = True
    stamp_error_ns: Final = 0

    def __init__(self, bus: SimulatedBus, name: str, queue_size: int, joined: list[Self]) -> None:
        self._bus, self._joined = bus, joined
        self._station = bus.attach(name, queue_size)
        self._backlog = Backlog()
        joined.append(self)

    def fileno(self) -> int:
        """Return -1: there is nothing to select; `bus.server.BusServer.ready` tells when frames wait."""
        return -1

    @property
    def is_ready(self) -> bool:
        """Whether frames wait."""
        return bool(self._backlog.parts)

    @property
    def dropped(self) -> int:
        """Number of frames lost because `receive` was not called."""
        return self._backlog.dropped

    @property
    def state(self) -> State:
        """State of the controller that is worst off."""
        return self._station.state

    def explain(self) -> str:
        """Return nothing: all is known from `state`."""
        return ""

    def offer(self, batch: Batch) -> None:
        """Take the records of a batch that are for this station."""
        self._backlog.keep(batch.of(self._station))

    def receive(self) -> Frames:
        """Return all waiting frames, echoes of own frames included, in bus order."""
        parts = self._backlog.parts
        arrived = parts[0] if len(parts) == 1 else np.concatenate((frames(0), *parts))
        parts.clear()
        return arrived

    def send(self, burst: Frames) -> int:
        """Put frames into the transmit queues that their `port` names, as `bus.arbitrated.ArbitratedLink.send`."""
        check_frames(burst, fd=self._bus.data_bitrate is not None)
        return self._bus.submit(self._station, padded(burst), time.monotonic_ns())

    def close(self) -> None:
        """Leave the bus."""
        if self in self._joined:
            self._joined.remove(self)
            self._bus.detach(self._station)
