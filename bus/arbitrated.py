"""The link to a bus of `skin bus`: packets of FRAME records on a local socket."""

import contextlib
import socket
import time
from os import fspath
from typing import Final

import msgspec
import numpy as np

from bus.error_frames import State
from bus.intake import (
    DROPPED,
    FD,
    HAS_FAILED,
    RETURNED,
    STATE,
    Bytes,
    Integers,
    arrived_in,
    new_intake,
    read_packets,
    send_packet,
)
from bus.interface import InterfaceError
from bus.protocol import (
    MAX_PACKET,
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
    unpack_json,
)
from bus.reconnecting import ReconnectingLink
from canskin.errors import BusError, Stopped
from dbc.frame import Frames, frame_bytes, frames
from shell.service import StopSignal, say

#: Time limit for the answer of the bus process to HELLO.
GREETING_S: Final = 5.0
#: After this time without the bus, a program logs that it waits.
SILENT_S: Final = 1.0


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
        self._own = new_intake(1)
        self._told = self._own.told[0]
        # Frames sent by port; those that the bus reported back are in `_told`, which another thread may write.
        self._sent, self._outgoing = np.zeros(MAX_PORTS, np.int64), np.empty(MAX_PACKET, np.uint8)
        try:
            self._use(self._connect_within(wait_s, stop or StopSignal()))
        except BaseException:
            self._epoll.close()
            raise

    def receive(self) -> Frames:
        """Return all waiting frames, echoes of own frames included, in bus order."""
        if self._reopened() is None:
            return frames(0)
        read_packets(self._told, self._own.rows[0], self._own.packet)
        return self.arrived(self._own.rows[0])

    def tell(self, told: Integers) -> None:
        """Use `told` for what is told of this link (`bus.intake`): who reads it with others has an array for all."""
        told[:], self._told = self._told, told

    def arrived(self, rows: Bytes) -> Frames:
        """Return the frames that were read into `rows`, and use what was told besides."""
        arrived = arrived_in(self._told, rows)
        self._state = State(min(int(self._told[STATE]), State.BUS_OFF))
        self._dropped = int(self._told[DROPPED])
        if self._told[HAS_FAILED] and self._socket is not None:
            self._lose(self._socket)
        return arrived

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
        rows, sent = frame_bytes(padded(burst)), 0
        with self._lock:
            connection = self._reopened()
            while connection is not None and sent < len(rows):
                count = send_packet(rows[sent:], self.welcome.queue_size, self._told, self._sent, self._outgoing)
                if count < 0:
                    self._lose(connection)
                if count <= 0:
                    self._is_full = True
                    break
                sent += count
        return sent

    def close(self) -> None:
        """Close the link."""
        super().close()
        self._told[FD] = -1

    def _use(self, connection: socket.socket) -> None:
        """Start to use a new socket."""
        super()._use(connection)
        self._told[:RETURNED] = connection.fileno(), True, False, 0, False, State.ACTIVE, 0

    def _lose(self, connection: socket.socket) -> None:
        """Drop a socket that has failed."""
        super()._lose(connection)
        if self._socket is None:
            self._told[:RETURNED] = -1, True, False, 0, False, State.ACTIVE, 0

    def _connect_within(self, wait_s: float, stop: StopSignal) -> socket.socket:
        since_s, said = time.monotonic(), False
        while True:
            try:
                return self._connect()
            except OSError as error:
                waited_s = time.monotonic() - since_s
                if waited_s >= wait_s:
                    raise BusError(
                        f"no bus '{self.channel}' at {self._path} ({error.strerror or error}):"
                        " start it with 'skin bus' or 'skin nodes'"
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
        self._sent[:] = self._told[RETURNED:] = 0
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
