"""The fabric that connects the services: zenoh with explicit endpoints and no multicast.

One process, the hub, listens. Every other process connects to the hub, and reconnects when the hub returns. Messages
that cannot be decoded raise no error; `Fabric.malformed` counts them.
"""

import json
import logging
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from itertools import count
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

import msgspec
import zenoh

from canskin.errors import UNDECODABLE, BusError, Stopped
from canskin.messages import Topic
from canskin.peers import EVERY_KEY, Peer, Roll, new_peer, peer_of_key
from canskin.question import Question

#: Name of the logger. Records have the attribute `service`.
LOG: Final = "canskin"

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"

#: After this time without a hub a service logs that it waits.
SILENT_S: Final = 3.0
#: A service that waits for the hub checks the stop signal at least this often.
TRY_S: Final = 1.0
#: Period of a search for services.
LOOK_S: Final = 0.1
#: Protocols of zenoh's links; those before ``serial`` need a port.
PROTOCOLS: Final = ("tcp", "udp", "tls", "quic", "ws", "serial", "unixpipe", "unixsock-stream", "vsock")
PROTOCOLS_WITH_PORT: Final = PROTOCOLS[:5]
HIGHEST_PORT: Final = 65535

_log: Final = logging.getLogger(LOG)

Message = TypeVar("Message", bound=msgspec.Struct)
#: Sends the answer to a request, once.
Reply = Callable[[msgspec.Struct], None]


class Stop(Protocol):
    """Tells whether to stop: a `threading.Event`, or a flag that signals set."""

    def is_set(self) -> bool:
        """Tell whether to stop."""
        ...


class Origin(NamedTuple):
    """Where a message comes from, as its attachment tells: a gap in the numbers is messages that were dropped.

    Attributes
    ----------
    publisher : str
        Differs from publisher to publisher, and from start to start.
    number : int
        Of the message among those of its publisher and topic, from 1.
    """

    publisher: str
    number: int


class Mailbox(Generic[Message]):
    """The newest messages of one topic; a slow reader loses the oldest messages, which are counted."""

    def __init__(self, depth: int) -> None:
        self._messages: deque[Message] = deque(maxlen=depth)
        self._arrived = threading.Condition()
        self.overrun = 0

    def put(self, message: Message) -> None:
        """Add a message; drop the oldest when full."""
        with self._arrived:
            self.overrun += len(self._messages) == self._messages.maxlen
            self._messages.append(message)
            self._arrived.notify()

    def get(self, timeout_s: float | None = None) -> Message | None:
        """Return the oldest waiting message, or None if no message came within `timeout_s`."""
        with self._arrived:
            if not self._arrived.wait_for(lambda: bool(self._messages), timeout_s):
                return None
            return self._messages.popleft()


class Exchange(Protocol):
    """Passes messages between services: the `Fabric`, or a replay in one process."""

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        """Send a message to every subscriber of `topic`."""
        ...

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        """Return a mailbox that holds the newest `depth` messages of `topic`."""
        ...


class Fabric:
    """Connection of one service to the other services.

    Parameters
    ----------
    skin : str
        Name of the skin; services of different skins exchange no messages.
    service : str
        Name that the others see while the connection exists; see `watch`. Several services may have the same name.
    endpoint : str
        zenoh endpoint, for example ``tcp/HOST:PORT``.
    hub : bool
        Listen on the endpoint instead of connecting to it.
    stop : Stop, optional
        If set while the constructor waits for the hub, `canskin.errors.Stopped` is raised.
    fingerprint : str
        Of this service's Φ. The other services see the fingerprint. Services with another Φ, another skin or another
        version are named in the log.
    patience_s : float
        Longest wait for the hub. By default a service waits without limit, so services start in any order.

    Raises
    ------
    BusError
        If the endpoint cannot be used, or no hub answered in time.
    """

    def __init__(
        self,
        skin: str,
        service: str,
        endpoint: str = DEFAULT_ENDPOINT,
        *,
        hub: bool = False,
        stop: Stop | None = None,
        fingerprint: str = "",
        patience_s: float = math.inf,
    ) -> None:
        self.malformed = 0
        self._peer = new_peer(skin, service, fingerprint)
        self._differences: set[str] = set()
        self._prefix = f"canskin/{skin}"
        self._encoder = msgspec.msgpack.Encoder()
        self._publishers: dict[str, Any] = {}
        self._numbers: dict[str, count[int]] = {}
        self._kept: list[Any] = []
        _check_endpoint(endpoint)
        self._session = _listen(endpoint) if hub else open_client(endpoint, service, stop, patience_s)
        self._kept.append(self._session.liveliness().declare_token(self._peer.key))
        if fingerprint:
            self.watch_peers(self._compare)

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        """Send `message` to every subscriber of `topic`; never waits, and a slow subscriber loses messages."""
        publisher = self._publishers.get(topic.name)
        if publisher is None:
            # Never BLOCK: a subscriber that hangs would delay the gateway's SYNC for seconds.
            key, control = f"{self._prefix}/{topic.name}", zenoh.CongestionControl.DROP
            publisher = self._session.declare_publisher(key, congestion_control=control)
            self._numbers[topic.name] = count(1)
            self._publishers[topic.name] = publisher
        mark = f"{self._peer.instance}-{next(self._numbers[topic.name])}"
        publisher.put(self._encoder.encode(message), attachment=mark)

    def subscribe(self, topic: Topic, handler: Callable[[Any], None]) -> None:
        """Call `handler` with every message of `topic`, in a thread of the fabric; the handler must be quick."""
        decoder = msgspec.msgpack.Decoder(topic.message)

        def receive(content: bytes, _origin: Origin | None) -> None:
            try:
                message = decoder.decode(content)
            except UNDECODABLE:
                self.malformed += 1
                return
            handler(message)

        self.subscribe_bytes(topic, receive)

    def subscribe_bytes(self, topic: Topic, handler: Callable[[bytes, Origin | None], None]) -> None:
        """Call `handler` with the bytes of every message of `topic`, not decoded, and its origin, if it tells one."""

        def receive(sample: Any) -> None:
            handler(sample.payload.to_bytes(), _origin_of(sample.attachment))

        self._kept.append(self._session.declare_subscriber(f"{self._prefix}/{topic.name}", receive))

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        """Return a mailbox that holds the newest `depth` messages of `topic`."""
        mailbox: Mailbox[Any] = Mailbox(depth)
        self.subscribe(topic, mailbox.put)
        return mailbox

    def answer(self, question: Question, handler: Callable[[Any, Reply], None]) -> None:
        """Call ``handler(request, reply)`` with every request, in a thread of the fabric.

        The handler, or another thread later, calls `reply` once with the answer. Requests that cannot be decoded are
        counted in `malformed`.
        """
        decoder = msgspec.msgpack.Decoder(question.request)
        encode = msgspec.msgpack.encode  # in any thread

        def receive(query: Any) -> None:
            try:
                request = decoder.decode(query.payload.to_bytes() if query.payload is not None else b"")
            except UNDECODABLE:
                self.malformed += 1
                return

            def reply(message: msgspec.Struct) -> None:
                try:
                    query.reply(query.key_expr, encode(message))
                    query.drop()
                except zenoh.ZError as error:  # the asker may be gone for minutes
                    _tell(self._peer.service, f"an answer to '{question.name}' is lost: {_first_sentence(error)}")

            handler(request, reply)

        self._kept.append(self._session.declare_queryable(f"{self._prefix}/{question.name}", receive))

    def ask(self, question: Question, request: msgspec.Struct, timeout_s: float) -> Any:
        """Return the answer to a request.

        Raises
        ------
        BusError
            If no service answers in time, or the answer cannot be decoded.
        """
        key, payload = f"{self._prefix}/{question.name}", self._encoder.encode(request)
        for reply in self._session.get(key, payload=payload, timeout=timeout_s):
            if reply.ok is not None:
                try:
                    return msgspec.msgpack.decode(reply.ok.payload.to_bytes(), type=question.reply)
                except UNDECODABLE as error:
                    raise BusError(
                        f"the answer cannot be decoded, it is of another version of canskin: {error}"
                    ) from error
        raise BusError(f"no service of skin '{self._peer.skin}' answers: is 'skin gateway' of this layout running?")

    def watch(self, changed: Callable[[str, bool], None]) -> None:
        """Call ``changed(service, alive)`` for every service that is present, comes or goes.

        Several services of one name count as one service, present from the first to the last of them.
        """
        there = Roll()

        def note(peer: Peer, alive: bool) -> None:
            if peer.skin == self._peer.skin and there.note(peer.service, peer.instance, alive):
                changed(peer.service, there.holds(peer.service))

        self.watch_peers(note)

    def watch_peers(self, changed: Callable[[Peer, bool], None]) -> None:
        """Call ``changed(peer, alive)`` for every service of every skin on the hub that is present, comes or goes."""

        def receive(sample: Any) -> None:
            changed(peer_of_key(str(sample.key_expr)), sample.kind == zenoh.SampleKind.PUT)

        self._kept.append(self._session.liveliness().declare_subscriber(EVERY_KEY, receive, history=True))

    def close(self) -> None:
        """Close the connection after all published messages are sent."""
        self._session.close()

    def _compare(self, peer: Peer, alive: bool) -> None:
        """Log, once per difference, that a service cannot work with this service."""
        if peer == self._peer:
            return
        _tell(self._peer.service, f"{peer.service} {'is there' if alive else 'has left'}", logging.INFO)
        difference = self._peer.difference(peer) if alive else ""
        if difference and difference not in self._differences:
            self._differences.add(difference)
            _tell(self._peer.service, difference)


def peers_at(endpoint: str, patience_s: float, is_enough: Callable[[list[Peer]], bool]) -> list[Peer]:
    """Return the services of all skins on a hub: as soon as `is_enough`, else those after `patience_s`.

    Raises
    ------
    BusError
        If the endpoint cannot be used, or no hub answers in time.
    """
    _check_endpoint(endpoint)
    give_up_s = time.monotonic() + patience_s
    session = open_client(endpoint, "client", None, patience_s)
    try:
        while True:
            tokens = session.liveliness().get(EVERY_KEY, timeout=TRY_S)
            peers = [peer_of_key(str(each.ok.key_expr)) for each in tokens if each.ok is not None]
            if is_enough(peers) or time.monotonic() + LOOK_S > give_up_s:
                return peers
            time.sleep(LOOK_S)
    finally:
        session.close()


def _tell(service: str, text: str, level: int = logging.WARNING) -> None:
    """Log a line in the name of a service."""
    _log.log(level, text, extra={"service": service})


def _origin_of(attachment: Any) -> Origin | None:
    """Return what an attachment tells; other programs attach nothing, or something else."""
    if attachment is None:
        return None
    told = re.fullmatch(rb"(\w+)-(\d{1,18})", attachment.to_bytes())
    return None if told is None else Origin(told[1].decode(), int(told[2]))


def _check_endpoint(endpoint: str) -> None:
    protocol, _, address = endpoint.partition("/")
    port = address.rpartition(":")[2]
    has_port = re.fullmatch(r".+:\d+", address) and int(port) <= HIGHEST_PORT
    if protocol not in PROTOCOLS or not address or (protocol in PROTOCOLS_WITH_PORT and not has_port):
        raise BusError(f"expected an endpoint such as {DEFAULT_ENDPOINT}, got '{endpoint}'")


def _listen(endpoint: str) -> Any:
    """Open the session of the hub."""
    try:
        return zenoh.open(_config(endpoint, hub=True))
    except zenoh.ZError as error:
        raise BusError(f"cannot listen on {endpoint}: {_first_sentence(error)}") from error


class Listener(NamedTuple):
    """Words of the messages about the process that listens on an endpoint: its name, who starts it, which option."""

    name: str = "hub"
    full_name: str = "the fabric's hub"
    starter: str = "'skin gateway'"
    option: str = "--connect"


def open_client(
    endpoint: str,
    service: str,
    stop: Stop | None,
    patience_s: float = math.inf,
    listener: Listener = Listener(),  # noqa: B008 - immutable
) -> Any:
    """Open a client's zenoh session in short attempts: signals are handled only between attempts.

    Parameters
    ----------
    endpoint : str
    service : str
        Name in the log.
    stop : StopSignal or None
        If set while this function waits, `canskin.errors.Stopped` is raised.
    patience_s : float
        Longest wait.
    listener : Listener
        Who listens on the endpoint.

    Raises
    ------
    BusError
        If the endpoint cannot be used, or nobody answered in time.
    """
    _check_endpoint(endpoint)
    started_s, said = time.monotonic(), False
    while True:
        left_s = patience_s - (time.monotonic() - started_s)
        try:
            session = zenoh.open(_config(endpoint, patience_s=max(0.0, min(TRY_S, left_s))))
        except zenoh.ZError as error:
            if stop is not None and stop.is_set():
                raise Stopped from None
            waited_s = time.monotonic() - started_s
            if waited_s >= patience_s:
                raise BusError(
                    f"no {listener.name} at {endpoint}: start {listener.starter}, or give another {listener.option}"
                ) from error
        else:
            if said:
                _tell(service, f"the {listener.name} is there")
            return session
        if waited_s >= SILENT_S and not said:
            _tell(service, f"waits for {listener.full_name} at {endpoint}, usually {listener.starter}")
            said = True


def _config(endpoint: str, *, hub: bool = False, patience_s: float = 0.0) -> Any:
    """Build a zenoh configuration that uses `endpoint` only."""
    config = zenoh.Config()
    settings = {
        "mode": "router" if hub else "client",
        "listen/endpoints": [endpoint] if hub else [],
        "connect/endpoints": [] if hub else [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "connect/timeout_ms": round(patience_s * 1000),
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _first_sentence(error: BaseException) -> str:
    """Return the cause from zenoh's nested message."""
    return str(error).split(" at ")[0].strip().rstrip(".")
