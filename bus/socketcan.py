"""The link to Linux SocketCAN: one raw socket, many frames per system call, every kernel drop counted."""

import contextlib
import errno
import socket
import sys
from pathlib import Path
from typing import Final

import numpy as np

from bus.datagrams import (
    DEVICE_STAMPS,
    MOST_DATAGRAMS,
    SO_RXQ_OVFL,
    SO_TIMESTAMPING,
    SO_TIMESTAMPNS,
    new_datagrams,
    read_datagrams,
    send_datagrams,
)
from bus.device_clock import DeviceClock
from bus.error_frames import State, state_of_report
from bus.intake import MOST_FRAMES
from bus.interface import (
    Controller,
    Interface,
    Wanted,
    check_interface,
    describe_interface,
    errors_text,
    read_interface,
)
from bus.protocol import check_frames, in_time, padded
from bus.reconnecting import ReconnectingLink
from bus.told import DATAGRAMS, DESCRIPTOR, DEVICE_ERROR, NEEDS_LOOK, NO_STAMPS, OFFSET, STAMP_ERROR, STATE
from canskin.errors import BusError
from dbc.frame import ERROR, FRAME, Frames, frame_bytes, frames
from dbc.frame_fields import Bytes
from shell.clock import wall_offset
from shell.service import say

#: Requested receive buffer: about 5,000 frames; the default holds about 250.
RECEIVE_BUFFER_BYTES: Final = 4 * 1024 * 1024

_SO_RCVBUFFORCE: Final = 33
_CAN_RAW_ERR_FILTER: Final = 2
#: Drivers of USB adapters that echo a frame when the adapter reports its transmission, one report a frame, in the
#: stream of received frames. Others echo at the end of the USB transfer (peak_usb), when the firmware has queued the
#: frame (gs_usb with candleLight), or in groups (ucan, etas_es58x).
_PROVEN_USB: Final = frozenset({"esd_usb", "esd_usb2", "kvaser_usb"})
#: Drivers whose interrupt thread passes on received frames before it looks for the end of the transmission.
_ANSWERS_FIRST: Final = frozenset({"hi3110", "mcp251x"})


class SocketCanLink(ReconnectingLink):
    """A raw CAN socket; it reconnects when a lost interface is back.

    The time of a frame is that of the kernel (SO_TIMESTAMPNS), taken in the interrupt after its end. The echo of a SYNC
    has the time stamp of the device where the interface has one (SO_TIMESTAMPING), see `bus.device_clock`.

    Parameters
    ----------
    channel : str
        Name of the interface.
    wanted : Wanted, optional
        The interface is compared with it at each opening.
    name : str
        In whose name the log tells settings of the interface.

    Raises
    ------
    BusError
        If the kernel has no CAN, no such interface, or one that cannot work as wanted.
    """

    _reader = DATAGRAMS

    def __init__(self, channel: str, wanted: Wanted | None = None, *, name: str = "link") -> None:
        super().__init__()
        self._channel = channel
        self._wanted = wanted or Wanted()
        self._name = name
        self._settings_told = ""
        self._device = DeviceClock()
        rows = np.empty((1, MOST_DATAGRAMS, FRAME.itemsize), np.uint8)
        self._words, self._outgoing = rows[0].view(np.int64), new_datagrams(rows)
        self._send(frame_bytes(frames(0)))  # what frames need is compiled before the first
        self._read()
        try:
            self._use(self._connect())
        except BusError:
            self._epoll.close()
            raise

    @property
    def proves_echo(self) -> bool:
        """Whether the driver echoes a frame after its transmission, or the interface has no wire (vcan).

        Without IFF_ECHO the kernel echoes a frame when the frame is queued; with it, see `_PROVEN_USB` and
        `_ANSWERS_FIRST`.
        """
        about, place = self._about(), Path("/sys/class/net", self._channel, "device")
        if about is None or not about.echoes:
            return about is not None and about.kind == "vcan"
        driver = (place / "driver").resolve().name
        is_usb = (place / "subsystem").resolve().name == "usb"
        return driver in _PROVEN_USB if is_usb else driver not in _ANSWERS_FIRST

    def explain(self) -> str:
        """Return what is known beyond the state, which is read from the kernel."""
        device = None if self._socket is None else self._read_controller()
        if device is None or self.state < State.PASSIVE:
            return super().explain()
        known = [] if device.errors is None else [errors_text(device.errors)]
        if self.state is State.BUS_OFF and device.restart_ms:
            known.append(f"it restarts after {device.restart_ms} ms")
        elif self.state is State.BUS_OFF:
            start = f"'ip link set {self._channel} type can restart' starts it"
            known.append("plug the adapter in again" if device.restart_ms is None else start)
        return "; ".join(known)

    @property
    def stamp_error_ns(self) -> int | None:
        """Bound of the error of the clock of the newest time stamps; None if the kernel gives none.

        From the wall clock, which the kernel uses, to CLOCK_MONOTONIC: the two are read one after the other, and the
        wall clock may have been set or slewed since the frames before.
        """
        error_ns = int(self._told[STAMP_ERROR])
        return None if error_ns == NO_STAMPS else error_ns

    def receive(self) -> Frames:
        """Return all waiting frames, own frames as echoes."""
        arrived = [super().receive()]
        while len(arrived[-1]) == MOST_DATAGRAMS and len(arrived) < MOST_FRAMES // MOST_DATAGRAMS:
            arrived.append(super().receive())
        return arrived[0] if len(arrived) == 1 else np.concatenate(arrived)

    def arrived(self, rows: Bytes) -> Frames:
        """Return the frames that were read into `rows`, and use what was told besides."""
        told, asks = self._told, self._told[NEEDS_LOOK]
        arrived = super().arrived(rows)
        if not asks:
            return arrived
        for report in arrived[arrived["flags"] & ERROR != 0]:
            told[STATE] = state_of_report(report, State(told[STATE]))
        for place in np.flatnonzero(arrived["expires_ns"]).tolist():
            # The echo of a SYNC, with the time of the device.
            echo = arrived[place]
            echo["time_ns"] = self._device.take(int(echo["expires_ns"]), int(echo["time_ns"]))
            echo["expires_ns"] = 0
        if told[STAMP_ERROR] != NO_STAMPS:
            told[STAMP_ERROR] += self._device.error_ns - told[DEVICE_ERROR]
        told[DEVICE_ERROR] = self._device.error_ns
        return arrived

    def _read(self) -> None:
        messages, parts = self._own.datagrams
        read_datagrams(self._told, self._own.rows[0], messages[0], parts[0], self._own.span)

    def _sendable(self, burst: Frames) -> Frames:
        check_frames(burst, fd=self._wanted.fd)
        return padded(in_time(burst))

    def _send(self, rows: Bytes) -> int:
        messages, parts = self._outgoing
        return send_datagrams(self._told[DESCRIPTOR], rows, self._words, messages[0], parts[0])

    def _use(self, connection: socket.socket) -> None:
        """Start to use a new socket; the controller may be in any state."""
        super()._use(connection)
        self._told[OFFSET], self._told[DEVICE_ERROR] = wall_offset().ns, self._device.error_ns
        self._read_controller()

    def _read_controller(self) -> Controller | None:
        about = self._about()
        device = None if about is None else about.controller
        if device is not None and device.state is not None:
            self._told[STATE] = device.state
        return device

    def _about(self) -> Interface | None:
        try:
            return read_interface(self._channel)
        except OSError:
            return None

    def _connect(self) -> socket.socket:
        """Open a socket."""
        try:
            return self._open()
        except OSError as error:
            raise BusError(_why(self._channel, error)) from error

    def _open(self) -> socket.socket:
        """Open and bind a new socket."""
        if sys.platform != "linux" or not hasattr(socket, "AF_CAN"):
            raise OSError(errno.EAFNOSUPPORT, "no CAN sockets on this system")
        self._check()
        connection = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            self._configure(connection)
            connection.bind((self._channel,))
        except BaseException:
            connection.close()
            raise
        return connection

    def _check(self) -> None:
        """Compare the interface with what is wanted: binding does not. Tell its settings once."""
        about = self._about()
        if about is None:
            return  # no such interface: binding will fail
        doubts = check_interface(self._channel, about, self._wanted)
        told = doubts or describe_interface(self._channel, about)
        if told and told != self._settings_told:
            say(self._name, told)
        self._settings_told = told

    def _configure(self, connection: socket.socket) -> None:
        raw, level = socket.SOL_CAN_RAW, socket.SOL_SOCKET
        connection.setblocking(False)
        connection.setsockopt(raw, socket.CAN_RAW_RECV_OWN_MSGS, 1)
        connection.setsockopt(raw, _CAN_RAW_ERR_FILTER, 0x1FFFFFFF)
        if self._wanted.fd:
            connection.setsockopt(raw, socket.CAN_RAW_FD_FRAMES, 1)
        connection.setsockopt(level, SO_TIMESTAMPNS, 1)
        with contextlib.suppress(OSError):  # before Linux 2.6.30
            connection.setsockopt(level, SO_TIMESTAMPING, DEVICE_STAMPS)
        connection.setsockopt(level, SO_RXQ_OVFL, 1)
        connection.setsockopt(level, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        with contextlib.suppress(PermissionError):  # above the system's limit, if permitted
            connection.setsockopt(level, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)


def _why(channel: str, error: OSError) -> str:
    """Return the error of an interface and what to do about it."""
    if error.errno in {errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT}:
        return f"cannot open {channel}: this system has no CAN sockets; load can_raw, or use --interface canskin"
    if error.errno == errno.ENODEV:
        return f"cannot open {channel}: no such interface; 'ip link' lists them"
    return f"cannot open {channel}: {error.strerror or error}"
