"""The common interface to all CAN interfaces: batches of FRAME records, with echoes of own frames."""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Protocol

from bus.error_frames import State
from bus.outbox import DISCARDED
from bus.protocol import Hello
from canskin.errors import InputError
from dbc.frame import Frames
from shell.service import StopSignal

__all__ = ["DISCARDED", "Link", "Send", "State", "open_link"]

#: Sends frames on a bus; returns how many of them, counted from the first, the transmit queue accepted.
Send = Callable[[Frames], int]

#: Longest name of a network interface, IFNAMSIZ - 1 of linux/if.h.
NAME_MAX: Final = 15
#: The interface name of `skin bus`.
ARBITRATED: Final = "canskin"
#: That of the kernel's interfaces.
SOCKETCAN: Final = "socketcan"


class Link(Protocol):
    """A connection to one CAN bus.

    Times of frames are CLOCK_MONOTONIC nanoseconds. `receive` returns a frame that this link has transmitted with ECHO,
    in bus order among the received frames. A frame that was given up comes with DISCARDED = ECHO | ERROR. Reports of
    errors come with ERROR.
    """

    def fileno(self) -> int:
        """Return a file descriptor that is readable while frames wait."""
        ...

    def receive(self) -> Frames:
        """Return all waiting frames; never wait."""
        ...

    def send(self, burst: Frames) -> int:
        """Queue frames for transmission; return the number of accepted frames, counted from the first.

        Raise InputError for a frame that no controller could send.
        """
        ...

    @property
    def proves_echo(self) -> bool:
        """Whether an echo comes when its frame has been on the bus, at its place among the received frames."""
        ...

    @property
    def stamp_error_ns(self) -> int | None:
        """Bound of the error of the clock of the newest time stamps; None if times are those at which frames were read.

        A time stamp of the kernel is besides later than the end of its frame, by the latency of an interrupt.
        """
        ...

    @property
    def dropped(self) -> int:
        """Number of frames lost on the receive side since the link was opened."""
        ...

    @property
    def state(self) -> State:
        """State of the controller."""
        ...

    def explain(self) -> str:
        """Return what is known beyond `state`: why the connection is lost, or a frame was refused since the last call.

        Empty if nothing is known; a frame that came too late is refused without a reason.
        """
        ...

    def close(self) -> None:
        """Leave the bus."""
        ...


def check_channels(interface: str, names: Sequence[str]) -> None:
    """Refuse names that no channel of the interface can have, and a name for two buses.

    SocketCAN's are those of Linux's network interfaces (``dev_valid_name`` of the kernel), other channels any words.
    """
    for name in names:
        if not name:
            raise InputError("expected the name of a channel, such as can0, got an empty name")
        refused = name in {".", ".."} or len(os.fsencode(name)) > NAME_MAX or re.search(r"[/:\s]", name)
        if interface == SOCKETCAN and refused:
            wanted = f"expected an interface's name of 1 to {NAME_MAX} bytes without space, '/' and ':'"
            raise InputError(f"{wanted}, such as can0, got {name!r}")
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"expected each channel once, got {twice[0]} for {names.count(twice[0])} buses: see --channel")


def open_link(
    interface: str,
    channel: str,
    bitrate: int,
    *,
    fd: bool = False,
    data_bitrate: int | None = None,
    name: str = "link",
    sends: bool = True,
    wait_s: float = 0.0,
    stop: StopSignal | None = None,
    options: Mapping[str, str | float | bool] | None = None,
) -> Link:
    """Open a CAN interface.

    Parameters
    ----------
    interface : str
        ``canskin`` for a bus of `skin bus`, ``socketcan``, or any interface of python-can.
    channel : str
        Channel of the interface.
    bitrate, data_bitrate : int
        Bits per second; an interface of SocketCAN must have been set up with them.
    fd : bool
        Allow CAN FD frames.
    name : str
        Name by which faults of a virtual bus select this connection, and in the log.
    sends : bool
        False for a program that only listens: SocketCAN's listen-only mode serves it.
    wait_s : float
        Longest wait for a virtual bus that is still starting.
    stop : StopSignal, optional
        If set during the wait, `canskin.errors.Stopped` is raised.
    options : mapping, optional
        Arguments of an interface of python-can.

    Raises
    ------
    InputError
        If there are options for an interface that takes none.
    BusError
        If the interface cannot be opened; `bus.interface.InterfaceError` if it is there, and set otherwise than wanted.
    """
    if options and interface in {ARBITRATED, SOCKETCAN}:
        raise InputError(f"expected no bus option for the interface '{interface}', got {', '.join(options)}")
    if interface == ARBITRATED:
        from bus.arbitrated import ArbitratedLink

        hello = Hello(name=name, bitrate=bitrate, data_bitrate=data_bitrate, fd=fd)
        return ArbitratedLink(channel, hello, wait_s=wait_s, stop=stop)
    if interface == SOCKETCAN:
        from bus.interface import Wanted
        from bus.socketcan import SocketCanLink

        return SocketCanLink(channel, Wanted(bitrate, data_bitrate, fd=fd, sends=sends), name=name)
    from bus.python_can import PythonCanLink

    return PythonCanLink(interface, channel, bitrate, fd=fd, data_bitrate=data_bitrate, options=options)
