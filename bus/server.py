"""The server of virtual buses: named buses on Unix sockets, and for links of its own process."""

import contextlib
import errno
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

import msgspec

from bus.faults import Fault
from bus.link import ARBITRATED, Link, check_channels
from bus.local import LocalLink
from bus.protocol import (
    MAX_PACKET,
    Hello,
    Kind,
    ProtocolError,
    Welcome,
    check_frames,
    pack,
    runtime_folder,
    socket_path,
    unpack,
    unpack_frames,
    unpack_json,
)
from bus.session import Batch, Session
from bus.simulated_bus import SimulatedBus
from canskin.errors import BusError, InputError
from canskin.session import own_folder
from dbc.frame import frames
from shell.service import RateLimitedLog, say

#: Period in which frames are delivered inside a burst; its first and last frames are delivered at once.
TICK_NS: Final = 2_000_000
#: Shortest time between two deliveries of one bus.
LEAST_NS: Final = 250_000
#: Longest sleep between two checks of the stop condition.
IDLE_S: Final = 0.1
#: A client that could not be taken is tried again after this time.
DEAF_NS: Final = 100_000_000
#: select() has a timeout in microseconds, but takes no descriptor above 1023.
MAX_CLIENTS: Final = 500
#: Most packets taken from one client before the other clients.
PACKETS_PER_TURN: Final = 64


@dataclass(frozen=True, kw_only=True)
class BusSettings:
    """Settings of all buses of a server.

    Attributes
    ----------
    bitrate, data_bitrate : int
        Bits per second; without `data_bitrate` CAN FD frames are refused.
    faults : sequence of Fault
    seed : int
        Seed of the faults; each bus adds its index in the list.
    restart_s : float
        Time that a bus-off controller waits before its recovery begins.
    queue_size : int
        Number of frames in the transmit queue of each controller.
    """

    bitrate: int = 1_000_000
    data_bitrate: int | None = 5_000_000
    faults: Sequence[Fault] = ()
    seed: int = 0
    restart_s: float = 0.1
    queue_size: int = 256


@dataclass(eq=False)
class _Line:
    """One bus, its socket and its clients."""

    channel: str
    bus: SimulatedBus
    listener: socket.socket
    path: Path
    pending: list[socket.socket] = field(default_factory=list)
    sessions: list[Session] = field(default_factory=list)
    local: list[LocalLink] = field(default_factory=list)
    delivered_ns: int = 0
    #: When the next delivery is due, None without one; made anew in each turn.
    wake_ns: int | None = None
    #: No client is taken before this time.
    deaf_ns: int = 0

    def fileno(self) -> int:
        return self.listener.fileno()


class AlreadyServedError(BusError):
    """Another process serves a bus of that name."""


class BusServer:
    """Serves buses; a context manager that removes the sockets at the end.

    Raises
    ------
    AlreadyServedError
        If a bus of that name is already served.
    BusError
        If its socket cannot be made.
    """

    def __init__(self, channels: Sequence[str], settings: BusSettings, folder: Path | None = None) -> None:
        self.settings = settings
        self._lines: list[_Line] = []
        self._now_ns = 0
        self._complain = RateLimitedLog("bus").say
        self._buffer = bytearray(MAX_PACKET + 1)
        dry = SimulatedBus(settings.bitrate)
        sender, _ = dry.attach("sender"), dry.attach("receiver")
        dry.submit(sender, frames(1))
        dry.run_until()  # compiled before the first client comes
        folder = folder or runtime_folder()
        check_channels(ARBITRATED, channels)
        try:
            own_folder(folder)
            for place, channel in enumerate(channels):
                self._lines.append(self._open(channel, place, folder))
        except OSError as error:
            self.close()
            raise BusError(f"cannot make the buses' sockets in {folder}: {error.strerror}") from error
        except (BusError, InputError):
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def buses(self) -> dict[str, SimulatedBus]:
        """The buses by name."""
        return {line.channel: line.bus for line in self._lines}

    def serve(self, stopped: Callable[[], bool]) -> None:
        """Serve until `stopped` returns True; it is called at least ten times a second."""
        while not stopped():
            self.turn()

    @contextlib.contextmanager
    def beside(self) -> Iterator[None]:
        """Serve in a thread while the body of the ``with`` block waits for others."""
        done = threading.Event()
        thread = threading.Thread(target=self.serve, args=(done.is_set,), name="buses")
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()

    def join(self, channel: str, name: str) -> LocalLink:
        """Return a link of this process, whose thread serves, to one of the buses; raise InputError for another."""
        for line in self._lines:
            if line.channel == channel:
                return LocalLink(line.bus, name, self.settings.queue_size, line.local)
        raise InputError(f"expected one of the buses {', '.join(self.buses)}, got '{channel}'")

    def ready(self, links: Iterable[Link], wait_s: float, *, whole: bool) -> Collection[Link]:
        """Serve until frames came for links of this process, at most for `wait_s`; with `whole` all that time.

        Returns
        -------
        collection of Link
            Those with frames.
        """
        until_s = time.monotonic() + wait_s
        while True:
            self.turn(max(0.0, until_s - time.monotonic()))
            ready = [link for link in links if isinstance(link, LocalLink) and link.is_ready]
            if (ready and not whole) or time.monotonic() >= until_s:
                return ready

    def turn(self, wait_s: float = IDLE_S) -> None:
        """Sleep until a client sends or a frame ends, at most for `wait_s`, and handle it."""
        readers: list[_Line | socket.socket | Session] = [each for each in self._lines if each.deaf_ns <= self._now_ns]
        for line in self._lines:
            readers += [*line.pending, *line.sessions]
        writers = [session for line in self._lines for session in line.sessions if session.blocked]
        readable, writable, _ = select.select(readers, writers, [], min(wait_s, self._sleep_s()))
        self._now_ns = time.monotonic_ns()  # all frames of one turn take part in the same arbitration
        if readable:
            self._hear(set(readable))
        for line in self._lines:
            self._deliver(line)
            for session in [session for session in line.sessions if session in writable]:
                self._flush(line, session)

    def _hear(self, ready: set[_Line | socket.socket | Session]) -> None:
        """Accept connections and read packets."""
        for line in self._lines:
            if line in ready:
                self._accept(line)
            for connection in [connection for connection in line.pending if connection in ready]:
                self._greet(line, connection)
            if heard := [session for session in line.sessions if session in ready]:
                for session in heard:
                    self._read(line, session)
                line.wake_ns = self._wake_ns(line)

    def close(self) -> None:
        """Disconnect all clients and remove the sockets."""
        for line in self._lines:
            line.path.unlink(missing_ok=True)
            for one in (line.listener, *line.pending, *(session.connection for session in line.sessions)):
                one.close()
        self._lines.clear()

    def _sleep_s(self) -> float:
        """Return the time until the next delivery."""
        for line in self._lines:
            line.wake_ns = self._wake_ns(line)
        wakes = [line.wake_ns for line in self._lines if line.wake_ns is not None]
        if not wakes:
            return IDLE_S
        return min(max(min(wakes) - time.monotonic_ns(), 0) * 1e-9, IDLE_S)

    @staticmethod
    def _wake_ns(line: _Line) -> int | None:
        """Return the time of the next delivery of a bus.

        Inside a burst this is the next tick, common to all buses; the end of a burst is delivered without delay.
        """
        event_ns = line.bus.next_event_ns()
        if event_ns is None:
            return None
        tick_ns = (line.delivered_ns // TICK_NS + 1) * TICK_NS
        return max(event_ns, line.delivered_ns + LEAST_NS, min(line.bus.idle_from_ns, tick_ns))

    def _open(self, channel: str, place: int, folder: Path) -> _Line:
        path = socket_path(channel, folder)
        settings = self.settings
        bus = SimulatedBus(
            settings.bitrate,
            settings.data_bitrate,
            faults=settings.faults,
            seed=settings.seed + place,
            restart_s=settings.restart_s,
        )
        return _Line(channel, bus, _listen(path, channel), path)

    def _accept(self, line: _Line) -> None:
        try:
            connection, _ = line.listener.accept()
        except OSError as error:  # most likely no descriptor is free, and the client waits on
            line.deaf_ns = self._now_ns + DEAF_NS
            self._complain(f"{line.channel}: cannot take a client: {error.strerror}")
            return
        connection.setblocking(False)
        line.pending.append(connection)
        if sum(len(one.pending) + len(one.sessions) for one in self._lines) > MAX_CLIENTS:
            self._refuse(line, connection, f"more than {MAX_CLIENTS} clients")

    def _greet(self, line: _Line, connection: socket.socket) -> None:
        """Read HELLO from a new client, and accept or refuse the client."""
        try:
            hello = _read_hello(connection)
        except BlockingIOError:
            return
        except (OSError, ProtocolError) as error:
            self._refuse(line, connection, f"not understood: {error}")
            return
        settings = self.settings
        if hello.bitrate not in (None, settings.bitrate):
            self._refuse(line, connection, f"it runs at {settings.bitrate} bit/s, not {hello.bitrate}")
        elif hello.fd and settings.data_bitrate is None:
            self._refuse(line, connection, "it has no CAN FD: start it with --data-bitrate")
        elif hello.fd and hello.data_bitrate not in (None, settings.data_bitrate):
            self._refuse(line, connection, f"its data rate is {settings.data_bitrate} bit/s, not {hello.data_bitrate}")
        else:
            self._welcome(line, connection, hello)

    def _welcome(self, line: _Line, connection: socket.socket, hello: Hello) -> None:
        settings = self.settings
        welcome = Welcome(
            bitrate=settings.bitrate,
            data_bitrate=settings.data_bitrate,
            queue_size=settings.queue_size,
        )
        try:
            connection.send(pack(Kind.WELCOME, msgspec.json.encode(welcome)))
        except OSError:
            self._refuse(line, connection, "")
            return
        line.pending.remove(connection)
        station = line.bus.attach(hello.name, settings.queue_size)
        line.sessions.append(Session(connection, station))

    @staticmethod
    def _refuse(line: _Line, connection: socket.socket, reason: str) -> None:
        with contextlib.suppress(OSError):
            connection.send(pack(Kind.REFUSED, reason.encode()))
        connection.close()
        line.pending.remove(connection)

    def _read(self, line: _Line, session: Session) -> None:
        """Read the packets of a client; a client that violates the protocol is disconnected."""
        try:
            for _ in range(PACKETS_PER_TURN):
                size = session.connection.recv_into(self._buffer)
                if not size:
                    self._lose(line, session, "")
                    return
                self._take(line, session, memoryview(self._buffer)[:size])
        except BlockingIOError:
            return
        except ConnectionError:  # the client has left unread frames behind
            self._lose(line, session, "")
        except (OSError, ProtocolError, InputError) as error:
            self._lose(line, session, f"disconnected: {error}")

    def _take(self, line: _Line, session: Session, packet: memoryview) -> None:
        header, payload = unpack(packet)
        if header.kind != Kind.FRAMES:
            raise ProtocolError(f"a packet of kind {header.kind}")
        burst = unpack_frames(header, payload)
        check_frames(burst, fd=self.settings.data_bitrate is not None)
        if line.bus.submit(session.station, burst, self._now_ns) < len(burst):
            raise ProtocolError("more frames than its transmit queue holds")

    def _deliver(self, line: _Line) -> None:
        """Deliver all that has ended on a bus."""
        now_ns = self._now_ns
        if line.wake_ns is None or line.wake_ns > now_ns:
            return
        events = line.bus.run_until(now_ns)
        if not len(events.frames):
            return
        line.delivered_ns = now_ns
        batch = Batch(events)
        for link in line.local:
            link.offer(batch)
        for session in list(line.sessions):
            try:
                session.offer(batch, line.bus.now_ns)
            except OSError:
                self._lose(line, session, "")

    def _flush(self, line: _Line, session: Session) -> None:
        try:
            session.flush(line.bus.now_ns)
        except OSError:
            self._lose(line, session, "")

    @staticmethod
    def _lose(line: _Line, session: Session, why: str) -> None:
        """Disconnect a client and remove its station."""
        if why:
            say("bus", f"{line.channel}: client '{session.station.name}' {why}")
        line.sessions.remove(session)
        line.bus.detach(session.station)
        session.connection.close()


def _listen(path: Path, channel: str) -> socket.socket:
    """Open the socket of a bus; a socket without a server is replaced."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.setblocking(False)
    try:
        try:
            listener.bind(os.fspath(path))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            _remove_stale(path, channel)
            listener.bind(os.fspath(path))
        listener.listen(64)
    except BaseException:
        listener.close()
        raise
    return listener


def _remove_stale(path: Path, channel: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
        else:
            raise AlreadyServedError(f"{channel} is already served at {path}: stop that process, or set SKIN_BUS_DIR")


def _read_hello(connection: socket.socket) -> Hello:
    header, payload = unpack(connection.recv(MAX_PACKET))
    if header.kind != Kind.HELLO:
        raise ProtocolError(f"expected a greeting, got a packet of kind {header.kind}")
    return unpack_json(payload, Hello)
