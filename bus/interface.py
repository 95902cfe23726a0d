"""A CAN interface as the kernel knows it, how it differs from a bus of the layout, and the command that mends it.

rtnetlink(7); attributes of ``include/uapi/linux/if_link.h`` and ``include/uapi/linux/can/netlink.h``.
"""

import os
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntFlag
from typing import Final, NamedTuple

from bus.error_frames import State
from bus.ip_link import RESTART_MS, TRANSMIT_QUEUE_FRAMES, sample_point, timing_options
from canskin.errors import BusError

#: MTU of an interface that carries CAN FD: ``sizeof(struct canfd_frame)``.
FD_BYTES: Final = 72
#: Shortest transmit queue without a warning, the kernel's default: SYNC, TIME, a command and `UNDER_WAY` of the master.
SHORTEST_QUEUE: Final = 10
#: Largest distance from the sample point that CiA recommends. A controller's clock may allow no nearer one.
SAMPLE_POINT_TOLERANCE: Final = 0.1

_RTM_NEWLINK, _RTM_GETLINK, _NLM_F_REQUEST = 16, 18, 1
#: ``struct nlmsghdr``, ``struct ifinfomsg``: length, type, flags, sequence, port; family, type, index, flags, change.
_HEADER: Final = struct.Struct("=IHHIIBxHiII")
_IFF_UP, _IFF_ECHO = 1, 1 << 18
_IFLA_MTU, _IFLA_QDISC, _IFLA_TXQLEN, _IFLA_LINKINFO = 4, 6, 13, 18
_IFLA_INFO_KIND, _IFLA_INFO_DATA = 1, 2
_IFLA_CAN_BITTIMING, _IFLA_CAN_BITTIMING_CONST, _IFLA_CAN_STATE, _IFLA_CAN_CTRLMODE = 1, 2, 4, 5
_IFLA_CAN_RESTART_MS, _IFLA_CAN_BERR_COUNTER, _IFLA_CAN_DATA_BITTIMING = 6, 8, 9
_NLA_TYPE_MASK: Final = 0x3FFF
#: By ``enum can_state``; a controller may also be stopped or asleep.
_STATES: Final = (State.ACTIVE, State.WARNING, State.PASSIVE, State.BUS_OFF)
_STATE_NAMES: Final = ("error-active", "error-warning", "error-passive", "bus-off")


class InterfaceError(BusError):
    """An interface is there, and set otherwise than wanted."""


class Mode(IntFlag):
    """Modes of a controller, ``CAN_CTRLMODE_*``, in which a bus does not work as it should."""

    LOOPBACK = 0x01
    LISTEN_ONLY = 0x02
    ONE_SHOT = 0x08
    PRESUME_ACK = 0x40
    FD_NON_ISO = 0x80


#: Effects of the modes, and the options of ip(8) that end them.
_EFFECTS: Final = {
    Mode.LISTEN_ONLY: ("it is listen-only: it neither sends nor acknowledges frames", "listen-only off"),
    Mode.LOOPBACK: ("it is in loopback: its frames may not reach the bus", "loopback off"),
    Mode.ONE_SHOT: ("it is one-shot: it does not repeat a frame that loses arbitration", "one-shot off"),
    Mode.PRESUME_ACK: ("it is presume-ack: it takes no notice of missing acknowledgements", "presume-ack off"),
    Mode.FD_NON_ISO: ("it is fd-non-iso: boards of ISO 11898-1:2015 cannot read its CAN FD frames", "fd-non-iso off"),
}


@dataclass(frozen=True)
class Timing:
    """Bit rate in bit/s, and sample point as a ratio of the bit."""

    bit_rate_hz: int
    sample_point: float

    def __str__(self) -> str:
        """Return both as ip(8) writes them."""
        return f"{self.bit_rate_hz} bit/s" + (f", sample point {self.sample_point:.3f}" if self.sample_point else "")


@dataclass(frozen=True)
class Controller:
    """The CAN controller of an interface of the kind ``can``.

    Attributes
    ----------
    timing, data_timing : Timing or None
        Of the arbitration and of the data phase; None where the kernel does not know them.
    state : State or None
        None for a controller that is stopped.
    modes : Mode
    restart_ms : int or None
        From bus-off to the restart; 0 for never, None where the driver cannot restart its controller.
    errors : tuple of int, or None
        Transmit and receive error counter (ISO 11898-1); None where the driver does not tell.
    """

    timing: Timing | None
    data_timing: Timing | None
    state: State | None
    modes: Mode
    restart_ms: int | None
    errors: tuple[int, int] | None


@dataclass(frozen=True)
class Interface:
    """A network interface.

    Attributes
    ----------
    kind : str
        Such as can or vcan; empty for an interface without kind.
    is_up : bool
    echoes : bool
        IFF_ECHO: the driver echoes a frame after its transmission.
    mtu : int
        Bytes.
    queue_frames : int or None
        Room of the transmit queue; None for an interface without queue.
    controller : Controller or None
        None for any other kind than can.
    """

    kind: str
    is_up: bool
    echoes: bool
    mtu: int
    queue_frames: int | None
    controller: Controller | None


def read_interface(channel: str) -> Interface:
    """Ask the kernel about an interface.

    Raises
    ------
    OSError
        If there is no such interface, or the kernel does not answer.
    """
    asked = _HEADER.pack(_HEADER.size, _RTM_GETLINK, _NLM_F_REQUEST, 1, 0, 0, 0, socket.if_nametoindex(channel), 0, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 0) as route:
        route.send(asked)
        return parse_interface(route.recv(1 << 16))


def parse_interface(answer: bytes) -> Interface:
    """Return the interface of an answer to RTM_GETLINK.

    Raises
    ------
    OSError
        If the answer is an error.
    """
    if len(answer) < _HEADER.size or struct.unpack_from("=H", answer, 4)[0] != _RTM_NEWLINK:
        number = -struct.unpack_from("=i", answer, 16)[0] if len(answer) >= 20 else 0
        raise OSError(number, os.strerror(number))
    flags = _HEADER.unpack_from(answer)[-2]
    about = _attributes(answer[_HEADER.size :])
    info = _attributes(about.get(_IFLA_LINKINFO, b""))
    kind = _text(info.get(_IFLA_INFO_KIND, b""))
    return Interface(
        kind,
        bool(flags & _IFF_UP),
        bool(flags & _IFF_ECHO),
        _numbers(about.get(_IFLA_MTU))[0],
        None if _text(about.get(_IFLA_QDISC, b"")) == "noqueue" else _numbers(about.get(_IFLA_TXQLEN))[0],
        _controller(_attributes(info.get(_IFLA_INFO_DATA, b""))) if kind == "can" else None,
    )


def _controller(about: dict[int, bytes]) -> Controller:
    state = _numbers(about.get(_IFLA_CAN_STATE), missing=len(_STATES))[0]
    counters = about.get(_IFLA_CAN_BERR_COUNTER, b"")
    # Without constants of its bit timing the controller is behind a firmware (slcan), which does not restart it.
    restarts = _IFLA_CAN_BITTIMING_CONST in about
    return Controller(
        _timing(about.get(_IFLA_CAN_BITTIMING)),
        _timing(about.get(_IFLA_CAN_DATA_BITTIMING)),
        _STATES[state] if state < len(_STATES) else None,
        Mode(_numbers(about.get(_IFLA_CAN_CTRLMODE))[1]),  # mask, flags
        _numbers(about.get(_IFLA_CAN_RESTART_MS))[0] if restarts else None,
        struct.unpack_from("=HH", counters) if len(counters) >= 4 else None,
    )


def _timing(data: bytes | None) -> Timing | None:
    """Return the first fields of ``struct can_bittiming``: bit rate, and sample point in tenths of a percent."""
    bit_rate_hz, sample_point = _numbers(data)
    return Timing(bit_rate_hz, sample_point / 1000) if bit_rate_hz else None


def _numbers(data: bytes | None, *, missing: int = 0) -> tuple[int, int]:
    """Return the first two u32 of an attribute, `missing` where the attribute is too short."""
    first, second = (
        struct.unpack_from("=I", data, at)[0] if data is not None and len(data) >= at + 4 else missing for at in (0, 4)
    )
    return first, second


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode("ascii", "replace")


def _attributes(data: bytes) -> dict[int, bytes]:
    """Return netlink attributes by type: each has a length, a type, and its data, padded to four bytes."""
    found, place = {}, 0
    while place + 4 <= len(data):
        length, kind = struct.unpack_from("=HH", data, place)
        if length < 4:
            break
        found[kind & _NLA_TYPE_MASK] = data[place + 4 : place + length]
        place += -(-length // 4) * 4
    return found


@dataclass(frozen=True)
class Wanted:
    """What a program wants of an interface.

    Attributes
    ----------
    bit_rate_hz : int or None
        None: any.
    data_bit_rate_hz : int or None
        Of CAN FD; None: any.
    fd : bool
        CAN FD frames.
    sends : bool
        False for a program that only listens.
    """

    bit_rate_hz: int | None = None
    data_bit_rate_hz: int | None = None
    fd: bool = False
    sends: bool = True


class _Difference(NamedTuple):
    """A setting that is not as wanted; `option` of ip(8) mends it, `is_of_can` after ``type can``."""

    is_grave: bool
    text: str
    option: str = ""
    is_of_can: bool = True


def check_interface(channel: str, about: Interface, wanted: Wanted) -> str:
    """Compare an interface with what is wanted.

    Returns
    -------
    str
        What is doubtful, and the command that mends it; empty if nothing is.

    Raises
    ------
    InterfaceError
        If the interface cannot work; the message ends with the command that mends everything.
    """
    found = list(_differences(about, wanted))
    if not found:
        return ""
    change = f"ip link set {channel}"
    # A queue may change at any time, the other settings while the interface is down.
    needs_down = any(each.option and (each.is_of_can or "mtu" in each.option) for each in found)
    words = [f"{change} down && {change}" if needs_down and about.is_up else change]
    words += [each.option for each in found if each.option and not each.is_of_can]
    words += ["up"] if needs_down or not about.is_up else []
    options = dict.fromkeys(each.option for each in found if each.option and each.is_of_can)
    words += ["type can", *options] if options else []
    said = f"{channel}: {'; '.join(each.text for each in found)}: '{' '.join(words)}'"
    if any(each.is_grave for each in found):
        raise InterfaceError(f"cannot open {said}")
    return said


def _differences(about: Interface, wanted: Wanted) -> Iterator[_Difference]:
    device = about.controller
    data_hz = (wanted.data_bit_rate_hz or wanted.bit_rate_hz) if wanted.fd else None
    timing = timing_options(wanted.bit_rate_hz, data_hz) if wanted.bit_rate_hz else ""
    if not about.is_up:
        yield _Difference(True, "it is down", timing if device is not None and device.timing is None else "")
    if wanted.fd and about.mtu < FD_BYTES:
        yield _Difference(True, "it carries no CAN FD", timing if device else f"mtu {FD_BYTES}", device is not None)
    if device is not None:
        for words, is_now, should_be in (
            ("bit rate", device.timing, wanted.bit_rate_hz),
            ("data bit rate", device.data_timing, data_hz),
        ):
            if is_now is None or should_be is None:
                continue
            if is_now.bit_rate_hz != should_be:
                yield _Difference(True, f"its {words} is {is_now}, the layout has {should_be} bit/s", timing)
            elif is_now.sample_point and abs(is_now.sample_point - sample_point(should_be)) > SAMPLE_POINT_TOLERANCE:
                text = f"its {words} is {is_now}, CiA recommends {sample_point(should_be):.3f}"
                yield _Difference(False, text, timing)
    if wanted.sends:
        yield from _doubts(about, device, fd=wanted.fd)


def _doubts(about: Interface, device: Controller | None, *, fd: bool) -> Iterator[_Difference]:
    """Name what matters to a program that sends."""
    if device is not None:
        for mode, (effect, option) in _EFFECTS.items():
            if device.modes & mode and (fd or mode is not Mode.FD_NON_ISO):
                yield _Difference(mode is Mode.LISTEN_ONLY, effect, option)
        if device.restart_ms == 0:
            text = "its restart-ms is 0: after bus-off it stays off the bus"
            yield _Difference(False, text, f"restart-ms {RESTART_MS}")
    if about.queue_frames is not None and about.queue_frames < SHORTEST_QUEUE:
        text = f"its transmit queue has room for {about.queue_frames} frames, expected {SHORTEST_QUEUE}"
        yield _Difference(False, text, f"txqueuelen {TRANSMIT_QUEUE_FRAMES}", is_of_can=False)


def describe_interface(channel: str, about: Interface) -> str:
    """Return the settings and the state of an interface with a controller in one line."""
    device = about.controller
    if device is None:
        return ""
    parts = [
        "bit rate unknown" if device.timing is None else str(device.timing),
        *([f"data {device.data_timing}"] if device.data_timing else []),
        "no restart after bus-off" if device.restart_ms is None else f"restart-ms {device.restart_ms}",
        f"queue of {about.queue_frames} frames",
        "stopped" if device.state is None else _STATE_NAMES[device.state],
        *([errors_text(device.errors)] if device.errors else []),
    ]
    return f"{channel}: {', '.join(parts)}"


def errors_text(errors: tuple[int, int]) -> str:
    """Return the transmit and the receive error counter in words."""
    return f"transmit errors {errors[0]}, receive errors {errors[1]}"
