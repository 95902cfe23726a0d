"""The link to a bus of `skin bus`: packets of FRAME records on a local socket."""

import contextlib
import socket
import time
from os import fspath
from typing import Final

import msgspec
import numpy as np

from bus.intake import read_packets, send_packet
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
from bus.told import PACKETS, RETURNED
from canskin.errors import BusError, Stopped
from dbc.frame import Frames
from dbc.frame_fields import Bytes
from shell.service import StopSignal, say

#: Time limit for the answer of the bus process to HELLO.
GREETING_S: Final = 5.0
#: After this time without the bus, a program logs that it waits.
SILENT_S: Final = 1.0


class ArbitratedLink(ReconnectingLink):
    """A connection to one bus of `skin bus`; it reconnects when this process is started again.

    A frame goes to the transmit queue that its `port` names. `time_ns` is its earliest start on the bus's clock, 0 for
    at once; `expires_ns` the latest, 0 for none.

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

    _reader = PACKETS

    def __init__(self, channel: str, hello: Hello, *, wait_s: float = 0.0, stop: StopSignal | None = None) -> None:
        super().__init__()
        self.channel = channel
        self._hello = hello
        self._path = socket_path(channel)
        # Frames sent by port; those that the bus reported back are in `_told`, which another thread may write.
        self._sent, self._outgoing = np.zeros(MAX_PORTS, np.int64), np.empty(MAX_PACKET, np.uint8)
        try:
            self._use(self._connect_within(wait_s, stop or StopSignal()))
        except BaseException:
            self._epoll.close()
            raise

    def _read(self) -> None:
        read_packets(self._told, self._own.rows[0], self._own.packet)

    def _sendable(self, burst: Frames) -> Frames:
        check_frames(burst, fd=self.welcome.data_bitrate is not None)
        return padded(burst)

    def _send(self, rows: Bytes) -> int:
        return send_packet(rows, self.welcome.queue_size, self._told, self._sent, self._outgoing)

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
