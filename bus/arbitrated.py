"""The link to a bus of `skin bus`: packets of FRAME records on a local socket."""

import contextlib
import socket
import time
from os import fspath
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt
from numba import int64, void

from bus.error_frames import State
from bus.interface import InterfaceError
from bus.protocol import (
    HEADER,
    MAX_FRAMES,
    MAX_PACKET,
    MAX_PAYLOAD,
    MAX_PORTS,
    Hello,
    Kind,
    ProtocolError,
    Welcome,
    check_frames,
    pack,
    padded,
    socket_path,
    unpack,
    unpack_frames,
    unpack_json,
)
from bus.reconnecting import ReconnectingLink
from canskin.errors import BusError, Stopped
from dbc.frame import ECHO, FLAGS_AT, FRAME, PORT_AT, Frames, frame_bytes, frames
from dbc.frame_fields import ROWS, field
from shell.compiled import njit
from shell.service import StopSignal, say

#: Time limit for the answer of the bus process to HELLO.
GREETING_S: Final = 5.0
#: After this time without the bus, a program logs that it waits.
SILENT_S: Final = 1.0
#: Most packets of full size taken by one `receive`, so that a flood of packets cannot block the caller.
PACKETS_PER_CALL: Final = 16


class ArbitratedLink(ReconnectingLink):
    """A connection to one bus of `skin bus`; it reconnects when this process is started again.

    `send` may be called from several threads, `receive` from one.

    Parameters
    ----------
    channel : str
        Name of the bus.
    hello : Hello
        The request: bit rates, name.
    wait_s : float
        Longest wait for a bus that is not served yet.
    stop : StopSignal, optional
        If set during the wait, `canskin.errors.Stopped` is raised.

    Raises
    ------
    BusError
        If the bus is not served, or refuses the connection.
    """

    def __init__(self, channel: str, hello: Hello, *, wait_s: float = 0.0, stop: StopSignal | None = None) -> None:
        super().__init__()
        self.channel = channel
        self._hello = hello
        self._path = socket_path(channel)
        self._header = memoryview(bytearray(HEADER.size))
        self._payloads = memoryview(bytearray(PACKETS_PER_CALL * MAX_PAYLOAD))
        # Two counters, each written by one thread only: frames sent, and frames reported back by the bus.
        self._sent = np.zeros(MAX_PORTS, np.int64)
        self._returned = np.zeros(MAX_PORTS, np.int64)
        try:
            self._use(self._connect_within(wait_s, stop or StopSignal()))
        except BaseException:
            self._epoll.close()
            raise

    def receive(self) -> Frames:
        """Return all waiting frames, echoes of own frames included, in bus order."""
        connection = self._reopened()
        if connection is None:
            return frames(0)
        end = 0
        try:
            while end + MAX_PAYLOAD <= len(self._payloads):
                size = connection.recvmsg_into([self._header, self._payloads[end:]])[0]
                if not size:
                    self._lose(connection)
                    break
                header, _ = unpack(self._header[:size])
                end += unpack_frames(header, self._payloads[end : end + size - HEADER.size]).nbytes
                if header.state != self._state:
                    self._state = State(min(header.state, State.BUS_OFF))
                self._dropped = header.dropped
        except BlockingIOError:
            pass
        except (OSError, ProtocolError):
            self._lose(connection)
        return self._returned_of(np.frombuffer(self._payloads[:end], FRAME).copy())

    def send(self, burst: Frames) -> int:
        """Put frames into the transmit queues that their `port` names.

        Parameters
        ----------
        burst : array of FRAME, shape (n,)
            `time_ns` is the earliest start on the bus's clock, 0 for at once; `expires_ns` the latest, 0 for none.

        Returns
        -------
        int
            Number of accepted frames, counted from the first; the next frame did not fit.
        """
        check_frames(burst, fd=self.welcome.data_bitrate is not None)
        burst = padded(burst)
        with self._lock:
            connection = self._reopened()
            if connection is None:
                return 0
            sent = 0
            while sent < len(burst):
                part = burst[sent : sent + MAX_FRAMES]
                rows = frame_bytes(part)
                count = int(_count_fitting(rows, self.welcome.queue_size - (self._sent - self._returned)))
                if not count or not self._send(connection, pack(Kind.FRAMES, part[:count].tobytes(), count=count)):
                    break
                _count_ports(rows[:count], 0, self._sent)
                sent += count
            self._is_full |= sent < len(burst)
            return sent

    def _send(self, connection: socket.socket, packet: bytes) -> bool:
        try:
            connection.send(packet)
        except BlockingIOError:
            return False
        except OSError:
            self._lose(connection)
            return False
        return True

    def _returned_of(self, arrived: Frames) -> Frames:
        """Count the own frames that have come back."""
        _count_ports(frame_bytes(arrived), ECHO, self._returned)
        return arrived

    def _connect_within(self, wait_s: float, stop: StopSignal) -> socket.socket:
        since_s, said = time.monotonic(), False
        while True:
            try:
                return self._connect()
            except OSError as error:
                waited_s = time.monotonic() - since_s
                if waited_s >= wait_s:
                    raise BusError(
                        f"no bus '{self.channel}' at {self._path} ({error.strerror or error}): start it with 'skin bus'"
                    ) from error
            if waited_s > SILENT_S and not said:
                say(self._hello.name, f"waits for bus '{self.channel}'")
                said = True
            if stop.wait(0.02):
                raise Stopped

    def _connect(self) -> socket.socket:
        """Connect and send HELLO."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            connection.settimeout(GREETING_S)
            connection.connect(fspath(self._path))
            self.welcome = self._read_welcome(self._greet(connection))
            connection.setblocking(False)
        except ProtocolError as error:
            connection.close()
            raise ConnectionResetError(str(error)) from error
        except BaseException:
            connection.close()
            raise
        self._sent[:] = self._returned[:] = 0
        return connection

    def _greet(self, connection: socket.socket) -> bytes:
        """Send HELLO and return the answer."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # a bus that is full refuses unasked
            connection.send(pack(Kind.HELLO, msgspec.json.encode(self._hello)))
            return connection.recv(MAX_PACKET)
        return connection.recv(MAX_PACKET)

    def _read_welcome(self, packet: bytes) -> Welcome:
        header, payload = unpack(packet)
        if header.kind != Kind.WELCOME:
            raise InterfaceError(f"bus '{self.channel}' refuses: {payload.tobytes().decode(errors='replace')}")
        return unpack_json(payload, Welcome)


@njit(int64(ROWS, int64[::1]), cache=True, nogil=True)
def _count_fitting(rows: npt.NDArray[np.uint8], left: npt.NDArray[np.int64]) -> int:
    """Count the leading frames that fit their transmit queues, which have `left` places by port; changes `left`."""
    for place in range(len(rows)):
        port = field(rows[place], PORT_AT, 2)
        if left[port] <= 0:
            return place
        left[port] -= 1
    return len(rows)


@njit(void(ROWS, int64, int64[::1]), cache=True, nogil=True)
def _count_ports(rows: npt.NDArray[np.uint8], flags: int, counts: npt.NDArray[np.int64]) -> None:
    """Add the frames that have all `flags` to the counts of their ports."""
    for place in range(len(rows)):
        if rows[place, FLAGS_AT] & flags == flags:
            counts[field(rows[place], PORT_AT, 2) % MAX_PORTS] += 1
