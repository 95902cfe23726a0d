"""The link to Linux SocketCAN: one raw socket, many frames per system call, every kernel drop counted."""

import contextlib
import errno
import socket
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from bus.device_clock import DeviceClock
from bus.error_frames import State, state_of_report
from bus.interface import (
    FD_BYTES,
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
from bus.recvmmsg import DEVICE_STAMPS, SO_RXQ_OVFL, SO_TIMESTAMPING, SO_TIMESTAMPNS, BatchSocket, Received
from canskin.errors import BusError
from dbc.canopen import SYNC_COB_ID
from dbc.frame import (
    BRS,
    CAN_ID_AT,
    DATA_AT,
    ECHO,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FLAGS_AT,
    LENGTH_AT,
    REMOTE,
    TIME_AT,
    Frames,
    frame_bytes,
    frames,
)
from shell.clock import WallOffset, wall_offset
from shell.compiled import njit
from shell.service import say

BATCH_FRAMES: Final = 256
#: Requested receive buffer: about 5,000 frames; the default holds about 250.
RECEIVE_BUFFER_BYTES: Final = 4 * 1024 * 1024

#: ``struct canfd_frame``; ``struct can_frame`` is its first 16 bytes.
WIRE: Final = np.dtype(
    [("can_id", "=u4"), ("length", "u1"), ("flags", "u1"), ("reserved", "u1", (2,)), ("data", "u1", (64,))]
)
_WIRE_LENGTH_AT, _WIRE_FLAGS_AT, _WIRE_DATA_AT = 4, 5, 8
CLASSIC_BYTES: Final = 16
_EFF, _RTR, _ERR = 0x80000000, 0x40000000, 0x20000000
_FD_BRS, _FD_ESI = 0x01, 0x02
#: Flag of the kernel on a frame that this socket sent.
_MSG_CONFIRM: Final = 0x800
_SO_RCVBUFFORCE: Final = 33
_CAN_RAW_ERR_FILTER: Final = 2
#: Drivers of USB adapters that echo a frame when the adapter reports its transmission, one report a frame, in the
#: stream of received frames. Others echo at the end of the USB transfer (peak_usb), when the firmware has queued the
#: frame (gs_usb with candleLight), or in groups (ucan, etas_es58x).
_PROVEN_USB: Final = frozenset({"esd_usb", "esd_usb2", "kvaser_usb"})
#: Drivers whose interrupt thread passes on received frames before it looks for the end of the transmission.
_ANSWERS_FIRST: Final = frozenset({"hi3110", "mcp251x"})


def encode(burst: Frames) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.intp]]:
    """Return frames as rows of 72 bytes, and the number of bytes to send of each."""
    wire = np.zeros(len(burst), WIRE)
    flags = burst["flags"]
    is_fd = flags & FD != 0
    wire["can_id"] = burst["can_id"]
    wire["can_id"] |= np.where(flags & EXTENDED, np.uint32(_EFF), np.uint32(0))
    wire["can_id"] |= np.where(flags & REMOTE, np.uint32(_RTR), np.uint32(0))
    wire["length"], wire["data"] = burst["length"], burst["data"]
    wire["flags"] = np.where(flags & BRS, _FD_BRS, 0) | np.where(flags & ESI, _FD_ESI, 0)
    return wire.view(np.uint8).reshape(-1, FD_BYTES), np.where(is_fd, FD_BYTES, CLASSIC_BYTES)


def decode(batch: Received, offset_ns: int) -> Frames:
    """Convert received datagrams to records; `offset_ns` is wall clock minus CLOCK_MONOTONIC."""
    arrived = frames(len(batch.lengths))
    parts = batch.rows, batch.lengths, batch.flags, batch.time_ns
    count = _decode_all(*parts, offset_ns, time.monotonic_ns(), frame_bytes(arrived))
    return arrived[:count]


@njit(cache=True, nogil=True)
def _decode_all(  # noqa: PLR0917  compiled functions take no keywords
    rows: npt.NDArray[np.uint8],
    sizes: npt.NDArray[np.uint32],
    message_flags: npt.NDArray[np.int32],
    stamps_ns: npt.NDArray[np.int64],
    offset_ns: int,
    now_ns: int,
    arrived: npt.NDArray[np.uint8],
) -> int:
    """Write the datagrams that are frames into `arrived`, rows of zeros; return their number."""
    count = 0
    for place in range(len(sizes)):
        if sizes[place] != CLASSIC_BYTES and sizes[place] != FD_BYTES:
            continue
        row, record, is_fd = rows[place], arrived[count], sizes[place] == FD_BYTES
        count += 1
        word = 0
        for byte in range(4):
            word |= int(row[byte]) << (8 * byte)
        flags = FD if is_fd else 0
        for there, flag in ((word & _EFF, EXTENDED), (word & _RTR, REMOTE), (word & _ERR, ERROR)):
            flags |= flag if there else 0
        if is_fd:
            flags |= (BRS if row[_WIRE_FLAGS_AT] & _FD_BRS else 0) | (ESI if row[_WIRE_FLAGS_AT] & _FD_ESI else 0)
        flags |= ECHO if message_flags[place] & _MSG_CONFIRM else 0
        can_id = word & (0x1FFFFFFF if word & (_EFF | _ERR) else 0x7FF)
        ended_ns = stamps_ns[place] - offset_ns if stamps_ns[place] > 0 else now_ns
        for byte in range(8):
            record[TIME_AT + byte] = (ended_ns >> (8 * byte)) & 0xFF
        for byte in range(4):
            record[CAN_ID_AT + byte] = (can_id >> (8 * byte)) & 0xFF
        length = min(int(row[_WIRE_LENGTH_AT]), 64 if is_fd else 8)
        record[LENGTH_AT], record[FLAGS_AT] = length, flags
        # The buffer is reused: the bytes after a frame's data belong to an older frame.
        for byte in range(0 if flags & REMOTE else length):
            record[DATA_AT + byte] = row[_WIRE_DATA_AT + byte]
    return count


def _is_known(batch: Received) -> npt.NDArray[np.bool_]:
    known: npt.NDArray[np.bool_] = (batch.lengths == CLASSIC_BYTES) | (batch.lengths == FD_BYTES)
    return known


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

    def __init__(self, channel: str, wanted: Wanted | None = None, *, name: str = "link") -> None:
        super().__init__()
        self._channel = channel
        self._wanted = wanted or Wanted()
        self._name = name
        self._told = ""
        self._offset = wall_offset()
        self._stamp_error_ns: int | None = self._offset.error_ns
        self._device = DeviceClock()
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
        if device is None or self._state < State.PASSIVE:
            return super().explain()
        known = [] if device.errors is None else [errors_text(device.errors)]
        if self._state is State.BUS_OFF and device.restart_ms:
            known.append(f"it restarts after {device.restart_ms} ms")
        elif self._state is State.BUS_OFF:
            start = f"'ip link set {self._channel} type can restart' starts it"
            known.append("plug the adapter in again" if device.restart_ms is None else start)
        return "; ".join(known)

    @property
    def stamp_error_ns(self) -> int | None:
        """Bound of the error of the clock of the newest time stamps; None if the kernel gives none.

        From the wall clock, which the kernel uses, to CLOCK_MONOTONIC: the two are read one after the other, and the
        wall clock may have been set or slewed since the frames before.
        """
        return self._stamp_error_ns

    def receive(self) -> Frames:
        """Return all waiting frames, own frames as echoes."""
        arrived: list[Frames] = []
        before, self._offset = self._offset, wall_offset()
        has_stamps = True
        for _ in range(64):
            batch = self._receive_batch()
            if batch is None or not len(batch.rows):
                break
            if batch.dropped is not None:
                self._dropped = batch.dropped
            arrived.append(decode(batch, self._offset.ns))
            has_stamps &= bool(batch.time_ns.all())
            if batch.device_ns.any():
                self._use_device(arrived[-1], batch)
            if len(batch.rows) < BATCH_FRAMES:
                break
        if arrived:
            self._stamp_error_ns = self._clock_error_ns(before) if has_stamps else None
        together = arrived[0] if len(arrived) == 1 else np.concatenate((frames(0), *arrived))
        for report in together[together["flags"] & ERROR != 0]:
            self._state = state_of_report(report, self._state)
        return together

    def send(self, burst: Frames) -> int:
        """Pass frames to the interface's queue; return the number of accepted frames, counted from the first.

        A frame whose latest start has passed is not accepted; in the queue that time has no effect.
        """
        check_frames(burst, fd=self._wanted.fd)
        rows, lengths = encode(padded(in_time(burst)))
        sent = 0
        with self._lock:
            while sent < len(rows) and (connection := self._reopened()) is not None:
                try:
                    done = self._sender.send(rows[sent:], lengths[sent:])
                except OSError:
                    self._lose(connection)
                    break
                if not done:
                    self._is_full = True
                    break
                sent += done
        return sent

    def _clock_error_ns(self, before: WallOffset) -> int:
        return self._offset.error_ns + abs(self._offset.ns - before.ns) + self._device.error_ns

    def _use_device(self, arrived: Frames, batch: Received) -> None:
        """Replace the times of SYNC's echoes by those of the device."""
        device_ns = batch.device_ns[_is_known(batch)]
        is_sync = (arrived["can_id"] == SYNC_COB_ID) & (arrived["flags"] & ~np.uint8(FD | BRS | ESI) == ECHO)
        for place in np.flatnonzero(is_sync & (device_ns > 0)):
            arrived["time_ns"][place] = self._device.take(int(device_ns[place]), int(arrived["time_ns"][place]))

    def _receive_batch(self) -> Received | None:
        connection = self._reopened()
        if connection is None:
            return None
        try:
            return self._batch.receive()
        except OSError:  # ENETDOWN, ENODEV: the interface is down or gone
            self._lose(connection)
            return None

    def _use(self, connection: socket.socket) -> None:
        """Start to use a new socket; the controller may be in any state."""
        super()._use(connection)
        self._read_controller()

    def _read_controller(self) -> Controller | None:
        about = self._about()
        device = None if about is None else about.controller
        if device is not None and device.state is not None:
            self._state = device.state
        return device

    def _about(self) -> Interface | None:
        try:
            return read_interface(self._channel)
        except OSError:
            return None

    def _connect(self) -> socket.socket:
        """Open a socket with its buffers."""
        try:
            connection = self._open()
        except OSError as error:
            raise BusError(_why(self._channel, error)) from error
        self._batch = BatchSocket(connection, BATCH_FRAMES, FD_BYTES)
        decode(self._batch.received(0), 0)  # compiled before the first frame
        self._sender = BatchSocket(connection, BATCH_FRAMES, FD_BYTES)
        return connection

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
        if told and told != self._told:
            say(self._name, told)
        self._told = told

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
