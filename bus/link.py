"""One kind of access to every CAN interface: batches of FRAME records, echoes of own frames in their place."""

from collections.abc import Sequence
from typing import Protocol

from bus.error_frames import State
from bus.outbox import DISCARDED
from bus.protocol import Filter, Hello
from dbc.frame import Frames
from skin.service import StopSignal

__all__ = ["DISCARDED", "Filter", "Link", "State", "open_link"]

#: The interface name of `skin bus`.
ARBITRATED = "canskin"


class Link(Protocol):
    """A connection to one CAN bus.

    Times of frames are CLOCK_MONOTONIC nanoseconds. A frame this link sent comes back from `receive` with ECHO
    when it had been transmitted, in its place among the received ones, or with DISCARDED, which is ECHO and ERROR,
    when it was given up. Reports of errors come with ERROR.
    """

    def fileno(self) -> int:
        """Return a descriptor that is readable when frames wait."""
        ...

    def receive(self) -> Frames:
        """Return all frames that wait, without waiting for any."""
        ...

    def send(self, burst: Frames) -> int:
        """Queue frames for transmission; return how many, from the first, fitted."""
        ...

    @property
    def dropped(self) -> int:
        """Frames lost on the receive side since the link was opened."""
        ...

    @property
    def state(self) -> State:
        """What the controller says of itself."""
        ...

    def close(self) -> None:
        """Leave the bus."""
        ...


def open_link(
    interface: str,
    channel: str,
    bitrate: int,
    *,
    fd: bool = False,
    data_bitrate: int | None = None,
    filters: Sequence[Filter] | None = None,
    name: str = "link",
    wait_s: float = 0.0,
    stop: StopSignal | None = None,
) -> Link:
    """Open a CAN interface.

    Parameters
    ----------
    interface : str
        ``canskin`` for a bus of `skin bus`, ``socketcan``, or any interface of python-can.
    channel : str
        Which bus of that interface.
    bitrate, data_bitrate : int
        Bits per second; SocketCAN takes those its interface was set up with.
    fd : bool
        Allow CAN FD frames.
    filters : sequence of Filter, optional
        Which frames to receive, default all. Echoes of own frames may need to pass, too.
    name : str
        What faults of a virtual bus are aimed at.
    wait_s : float
        How long to wait for a virtual bus that is still starting.
    stop : StopSignal, optional
        Raises `skin.service.Stopped` if it is set meanwhile.

    Raises
    ------
    BusError
        If the interface cannot be opened, in one line.
    """
    allowed = tuple(filters or ())
    if interface == ARBITRATED:
        from bus.arbitrated import ArbitratedLink

        hello = Hello(name=name, bitrate=bitrate, data_bitrate=data_bitrate, fd=fd, filters=allowed)
        return ArbitratedLink(channel, hello, wait_s=wait_s, stop=stop)
    if interface == "socketcan":
        from bus.socketcan import SocketCanLink

        return SocketCanLink(channel, fd=fd, filters=allowed)
    from bus.python_can import PythonCanLink

    return PythonCanLink(interface, channel, bitrate, fd=fd, data_bitrate=data_bitrate, filters=allowed)
