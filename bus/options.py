"""Options for CAN interfaces: python-can's own flags."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, TypeVar

from cyclopts import Parameter

from bus.link import ARBITRATED, SOCKETCAN, Link, check_channels, open_link
from canskin.errors import InputError
from shell.service import StopSignal
from skin.layout import BITRATE_MAX, BITRATE_MIN, DATA_BITRATE_MAX, Layout
from skin.ranges import listed

if TYPE_CHECKING:
    from bus.server import BusServer

#: Longest wait of a service for a bus server that is still starting, and may have its kernels to compile first.
OPEN_WAIT_S = 60.0

_Bus = TypeVar("_Bus")

#: Names of channels on the command line: ``-c can0 can1`` or ``-c can0 -c can1``.
Channels = Annotated[list[str], Parameter(alias="-c", negative=(), consume_multiple=1, show_default=False)]


@Parameter(name="*")
@dataclass(frozen=True)
class BusOptions:
    """The CAN interfaces of the layout's buses.

    Parameters
    ----------
    interface : str
        python-can interface; ``canskin`` is the virtual bus of ``skin bus``.
    channel : list of str
        The channel of each bus, in the order of the layout. From a single channel with a number the others follow:
        ``-c can0`` means can0 to can3 for four buses. Default: the names of the buses.
    bus_option : list of str
        An argument of the python-can interface, for each bus: ``--bus-option tty_baudrate=1000000``. Most interfaces
        ignore names that they do not know.
    """

    interface: Annotated[str, Parameter(alias="-i")] = ARBITRATED
    channel: Channels = field(default_factory=list)
    bus_option: Annotated[list[str], Parameter(negative=(), show_default=False)] = field(default_factory=list)

    def __post_init__(self) -> None:
        object.__setattr__(self, "channel", listed(self.channel))
        options = [part for text in self.bus_option for part in re.split(r",(?=\w+=)", text)]
        object.__setattr__(self, "bus_option", options)


def channels(layout: Layout, options: BusOptions) -> list[str]:
    """Return one channel per bus of the layout; raise InputError for another number, or names that cannot be."""
    names = options.channel
    numbered = re.fullmatch(r"(.*?)(\d+)", names[0]) if len(names) == 1 else None
    if not names:
        names = [bus.name for bus in layout.bus]
    elif len(layout.bus) > 1 and numbered:
        names = [f"{numbered[1]}{int(numbered[2]) + index}" for index in range(len(layout.bus))]
    if len(names) != len(layout.bus):
        raise InputError(f"expected {len(layout.bus)} channels, one per bus of the layout, got {len(names)}")
    check_channels(options.interface, names)
    return names


def check_bit_rates(bitrate: int, data_bitrate: int | None) -> None:
    """Check bit rates that no layout names, bit/s; no data bit rate, or 0: no CAN FD."""
    if not BITRATE_MIN <= bitrate <= BITRATE_MAX:
        raise InputError(f"expected a bit rate of {BITRATE_MIN} to {BITRATE_MAX} bit/s, got {bitrate}")
    if data_bitrate and not bitrate <= data_bitrate <= DATA_BITRATE_MAX:
        wanted = f"a data bit rate of {bitrate} (the bit rate) to {DATA_BITRATE_MAX} bit/s, or 0 for no CAN FD"
        raise InputError(f"expected {wanted}, got {data_bitrate}")


def virtual_bit_rates(layout: Layout) -> tuple[int, int]:
    """Return bit rate and data bit rate of the layout's buses; raise InputError if they differ: one server has one."""
    rates = {(bus.bitrate, bus.data_bitrate or bus.bitrate) for bus in layout.bus}
    if len(rates) > 1:
        raise InputError("virtual buses of one server all have the same bit rates; this layout has several")
    return rates.pop()


def serve_buses(layout: Layout, options: BusOptions) -> "BusServer | None":
    """Serve the buses of a layout; return None where that cannot be, so that `open_links` opens them or says why not.

    The interface is no virtual bus, another process serves a bus, or bit rates differ.
    """
    if options.interface != ARBITRATED or options.bus_option:
        return None
    from bus.server import AlreadyServedError, BusServer, BusSettings

    try:
        bitrate, data_bitrate = virtual_bit_rates(layout)
        return BusServer(channels(layout, options), BusSettings(bitrate=bitrate, data_bitrate=data_bitrate))
    except (AlreadyServedError, InputError):
        return None


def open_links(
    layout: Layout,
    options: BusOptions,
    wanted: Iterable[int] | None = None,
    *,
    name: str = "link",
    sends: bool = True,
    stop: StopSignal | None = None,
    wait_s: float = OPEN_WAIT_S,
) -> dict[int, Link]:
    """Open the links of the buses numbered `wanted`, default all; the others as of `bus.link.open_link`.

    If `stop` is set during the wait for a bus, `canskin.errors.Stopped` is raised.
    """
    names, typed = channels(layout, options), _typed(options.bus_option)
    numbers = range(len(names)) if wanted is None else sorted(wanted)
    return {
        number: open_link(
            options.interface,
            names[number],
            (bus := layout.bus[number]).bitrate,
            fd=bus.fd,
            data_bitrate=bus.data_bitrate,
            name=name,
            sends=sends,
            wait_s=wait_s,
            stop=stop,
            options=typed,
        )
        for number in numbers
    }


@contextmanager
def closing_links(links: dict[_Bus, Link]) -> Iterator[dict[_Bus, Link]]:
    """Close all links at the end of a ``with`` block."""
    try:
        yield links
    finally:
        for link in links.values():
            link.close()


def open_channels(
    options: BusOptions, bitrate: int, data_bitrate: int | None, *, name: str, sends: bool = True
) -> dict[str, Link]:
    """Open channels that belong to no layout, as they are named; an interface of SocketCAN with its own rates."""
    check_channels(options.interface, options.channel)
    found = {}
    for channel in options.channel:
        rate, data_rate, fd = bitrate, data_bitrate, data_bitrate is not None
        if options.interface == SOCKETCAN:
            rate, data_rate, fd = _own_rates(channel, bitrate, data_bitrate)
        found[channel] = open_link(
            options.interface,
            channel,
            rate,
            fd=fd,
            data_bitrate=data_rate,
            name=name,
            sends=sends,
            options=_typed(options.bus_option),
        )
    return found


def _own_rates(channel: str, bitrate: int, data_bitrate: int | None) -> tuple[int, int | None, bool]:
    """Return bit rate and data bit rate of an interface where the kernel knows them, and whether it carries CAN FD."""
    from bus.interface import FD_BYTES, read_interface

    try:
        about = read_interface(channel)
    except OSError:  # no such interface: opening will say so
        return bitrate, data_bitrate, False
    if (device := about.controller) is not None:
        bitrate = bitrate if device.timing is None else device.timing.bit_rate_hz
        data_bitrate = data_bitrate if device.data_timing is None else device.data_timing.bit_rate_hz
    return bitrate, data_bitrate, about.mtu >= FD_BYTES


def _typed(given: list[str]) -> dict[str, str | float | bool]:
    """Return options with their values; raise InputError for what is not NAME=VALUE."""
    if not given:
        return {}
    from can.util import cast_from_string

    for each in given:
        if not re.fullmatch(r"\w+=.*", each):
            raise InputError(f"expected a bus option as NAME=VALUE, got {each!r}")
    return {name: cast_from_string(value) for name, _, value in (each.partition("=") for each in given)}
