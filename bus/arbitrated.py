"""The link to a bus of `skin bus`: packets of FRAME records on a local socket."""

import select
import socket
import threading
import time
from collections.abc import Sequence
from os import fspath
from typing import Final

import msgspec
import numpy as np

from bus.error_frames import State
from bus.faults import Fault
from bus.protocol import (
    MAX_FRAMES,
    MAX_PACKET,
    MAX_PORTS,
    Hello,
    Kind,
    ProtocolError,
    Welcome,
    check_frames,
    pack,
    pad_lengths,
    socket_path,
    unpack,
    unpack_frames,
    unpack_json,
)
from bus.retry import Backoff
from dbc.frame import ECHO, FD, Frames, frames
from skin.errors import BusError
from skin.service import Stopped, StopSignal, say

#: How long the process of a bus may take to answer a greeting.
GREETING_S: Final = 5.0
#: After this long without the bus, a program says that it waits.
SILENT_S: Final = 1.0
#: Packets taken by one `receive`, so that a flood cannot keep a caller in it.
PACKETS_PER_CALL: Final = 256


class ArbitratedLink:
    """A connection to one bus of `skin bus`, which comes back by itself when that process does.

    `send` may be called from several threads, `receive` from one.

    Parameters
    ----------
    channel : str
        Name of the bus.
    hello : Hello
        What is asked of it.
    wait_s : float
        How long to wait for a bus that is not there yet.
    stop : StopSignal, optional
        Raises `skin.service.Stopped` if it is set while this waits.

    Raises
    ------
    BusError
        If the bus is not there, or refuses.
    """

    def __init__(self, channel: str, hello: Hello, *, wait_s: float = 0.0, stop: StopSignal | None = None) -> None:
        self.channel = channel
        self._hello = hello
        self._path = socket_path(channel)
        self._lock = threading.RLock()
        self._backoff = Backoff()
        self._buffer = bytearray(MAX_PACKET)
        self._state = State.ACTIVE
        self._dropped = self._dropped_before = 0
        # Each is written by one thread only: what was sent, and what the bus has reported back.
        self._sent = np.zeros(MAX_PORTS, np.int64)
        self._returned = np.zeros(MAX_PORTS, np.int64)
        self._socket: socket.socket | None
        self._socket, self.welcome = self._connect_within(wait_s, stop or StopSignal())
        self._epoll = select.epoll()  # one descriptor for select, whatever happens to the socket
        self._epoll.register(self._socket, select.EPOLLIN)

    def fileno(self) -> int:
        """Return a descriptor that is readable when frames wait."""
        return self._epoll.fileno()

    @property
    def state(self) -> State:
        """The worst state of this link's controllers, or LOST while the bus's process is gone."""
        return State.LOST if self._socket is None else self._state

    @property
    def dropped(self) -> int:
        """Frames that were lost because `receive` was not called in time."""
        return self._dropped_before + self._dropped

    def receive(self) -> Frames:
        """Return all frames that wait, echoes of own ones included, in the order of the wire."""
        arrived: list[Frames] = []
        connection = self._reopened()
        try:
            while connection is not None and len(arrived) < PACKETS_PER_CALL:
                size = connection.recv_into(self._buffer)
                if not size:
                    self._lose(connection)
                    break
                arrived.append(self._unpack(memoryview(self._buffer)[:size]))
        except BlockingIOError:
            pass
        except (OSError, ProtocolError):
            self._lose(connection)
        if not arrived:
            return frames(0)
        return arrived[0] if len(arrived) == 1 else np.concatenate(arrived)

    def send(self, burst: Frames) -> int:
        """Put frames into the transmit queues that their `port` names.

        Parameters
        ----------
        burst : array of FRAME, shape (n,)
            `time_ns` is the earliest start on the bus's clock, 0 for at once; `expires_ns` the latest, 0 for none.

        Returns
        -------
        int
            How many were accepted, counted from the first; the next one did not fit.

        Raises
        ------
        InputError
            If a frame is none that a controller could send.
        """
        check_frames(burst, fd=self.welcome.data_bitrate is not None)
        if (burst["flags"] & FD).any():
            burst = burst.copy()
            pad_lengths(burst)
        with self._lock:
            connection = self._reopened()
            if connection is None:
                return 0
            sent = 0
            for first in range(0, self._fitting(burst), MAX_FRAMES):
                part = burst[first : min(first + MAX_FRAMES, len(burst))]
                part = part[: self._fitting(part)]
                if not self._send(connection, pack(Kind.FRAMES, part.tobytes(), count=len(part))):
                    break
                self._sent += np.bincount(part["port"], minlength=MAX_PORTS)
                sent += len(part)
            return sent

    def set_faults(self, faults: Sequence[Fault]) -> bool:
        """Replace the rules of what goes wrong on the bus; tell whether they were handed over."""
        with self._lock:
            connection = self._reopened()
            if connection is None:
                return False
            return self._send(connection, pack(Kind.FAULTS, msgspec.json.encode(list(faults))))

    def close(self) -> None:
        """Leave the bus."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            self._socket = None
            self._backoff.give_up()
            self._epoll.close()

    def _fitting(self, burst: Frames) -> int:
        """Count the leading frames for which there is room."""
        room = self.welcome.queue_size - (self._sent - self._returned)
        if (np.bincount(burst["port"], minlength=MAX_PORTS) <= room).all():
            return len(burst)
        for place, port in enumerate(burst["port"].tolist()):
            if room[port] <= 0:
                return place
            room[port] -= 1
        return len(burst)

    def _send(self, connection: socket.socket, packet: bytes) -> bool:
        try:
            connection.send(packet)
        except BlockingIOError:
            return False
        except OSError:
            self._lose(connection)
            return False
        return True

    def _unpack(self, packet: memoryview) -> Frames:
        """Read one packet, and take note of what its header and its echoes tell."""
        header, payload = unpack(packet)
        arrived = unpack_frames(header, payload).copy()
        self._state = State(min(header.state, State.BUS_OFF))
        self._dropped = header.dropped
        own = arrived["flags"] & ECHO != 0
        if not own.any():
            return arrived
        self._returned += np.bincount(arrived["port"][own] % MAX_PORTS, minlength=MAX_PORTS)
        return arrived

    def _lose(self, connection: socket.socket | None) -> None:
        """Let go of a connection that has ended."""
        with self._lock:
            if connection is None or connection is not self._socket:
                return
            self._epoll.unregister(connection)
            connection.close()
            self._socket = None
            self._backoff.failed()

    def _reopened(self) -> socket.socket | None:
        """Return the connection; when it is lost, try to get a new one, but not too often."""
        if self._socket is not None or not self._backoff.due:
            return self._socket
        with self._lock:
            if self._socket is None and self._backoff.due:
                try:
                    self._socket, self.welcome = self._connect()
                except (BusError, OSError):
                    self._backoff.failed()
                else:
                    self._backoff.worked()
                    self._epoll.register(self._socket, select.EPOLLIN)
                    self._dropped_before, self._dropped = self.dropped, 0
                    self._state = State.ACTIVE
                    self._sent[:] = self._returned[:] = 0
            return self._socket

    def _connect_within(self, wait_s: float, stop: StopSignal) -> tuple[socket.socket, Welcome]:
        since_s, told = time.monotonic(), False
        while True:
            try:
                return self._connect()
            except OSError as error:
                waited_s = time.monotonic() - since_s
                if waited_s >= wait_s:
                    raise BusError(
                        f"no bus '{self.channel}' at {self._path} ({error.strerror or error}): "
                        f"start it with 'skin bus {self.channel}'"
                    ) from error
            if waited_s > SILENT_S and not told:
                say(self._hello.name, f"waits for bus '{self.channel}'")
                told = True
            if stop.wait(0.02):
                raise Stopped

    def _connect(self) -> tuple[socket.socket, Welcome]:
        """Connect and greet.

        Raises
        ------
        OSError
            If nobody is there.
        BusError
            If the bus refuses.
        """
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            connection.settimeout(GREETING_S)
            connection.connect(fspath(self._path))
            connection.send(pack(Kind.HELLO, msgspec.json.encode(self._hello)))
            welcome = self._read_welcome(connection.recv(MAX_PACKET))
            connection.setblocking(False)
        except ProtocolError as error:
            connection.close()
            raise ConnectionResetError(str(error)) from error
        except BaseException:
            connection.close()
            raise
        return connection, welcome

    def _read_welcome(self, packet: bytes) -> Welcome:
        header, payload = unpack(packet)
        if header.kind != Kind.WELCOME:
            raise BusError(f"bus '{self.channel}' refuses: {payload.tobytes().decode(errors='replace')}")
        return unpack_json(payload, Welcome)
