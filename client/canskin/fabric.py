"""The fabric that connects the services: zenoh with explicit endpoints and no multicast.

One process, the hub, listens. Every other process connects to the hub, and reconnects when the hub returns. Messages
that cannot be decoded raise no error; `Fabric.malformed` counts them.
"""

import logging
import math
import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count
from typing import Any, ClassVar, Final, Generic, NamedTuple, Protocol, TypeVar

import msgspec
import zenoh

from canskin.errors import UNDECODABLE, BusError, DeniedError, tell
from canskin.keys import Keys, environment_keys
from canskin.messages import CONTACTS, IMAGE, LABEL, MEASUREMENT, UNKNOWN_ERROR_NS, Topic
from canskin.peers import EVERY_KEY, GATEWAYS, Peer, Roll, new_peer, peer_of_key
from canskin.question import Question
from canskin.roles import Action, refusal
from canskin.session import DEFAULT_ENDPOINT, LOOK_S, Stop, checked, first_sentence, open_client, open_hub, peers_of
from canskin.skin_clock import CLOCK_S, TIME, SkinClock, TimeRequest

Message = TypeVar("Message", bound=msgspec.Struct)
#: Sends the answer to a request, once.
Reply = Callable[[msgspec.Struct], None]
#: Returns a message that is decoded now; None if it cannot be decoded.
Unread = Callable[[], Any]
#: Longest wait for the other of two gateways that started at once to leave.
SETTLED_S: Final = 1.0
#: A younger publisher sends without knowing of a reader: the hub has to tell it first of those that are there.
FRESH_S: Final = 1.0
#: Whoever waits at a mailbox looks this often whether the wait is over.
WAKE_S: Final = 0.1
#: Least number of samples that zenoh keeps for the reader of a mailbox, who counts those that are missing.
_KEPT_MIN: Final = 64
#: Messages that pass between services of one process as they are: nobody can change them, their arrays are bytes.
_HANDED_OVER: Final = (MEASUREMENT, IMAGE)
#: Messages that several services may make of one measurement, see `Rising`.
_MADE_OF_CYCLES: Final = (IMAGE, CONTACTS, LABEL)
#: Once nobody has published for this time, any message is taken: the clock of a robot that boots begins anew.
FORGET_S: Final = 1.0
#: Most messages of this process that wait for a reader with a callback.
_WAITING_MAX: Final = 256
#: Most publishers and topics whose losses are counted, and most differences of other services that are logged.
_PUBLISHERS_MAX: Final = 1000
_DIFFERENCES_MAX: Final = 100


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


class _Publisher(NamedTuple):
    """Sends the messages of a topic; `wire` is zenoh's, `readers` are those of this process."""

    wire: Any
    numbers: "count[int]"
    fresh_until_s: float
    readers: "list[Reader]"


#: Is called with the bytes of a message, or with a message that is handed over, and with its origin.
Reader = Callable[[Any, Origin], None]


class Missed:
    """Counts the messages that the fabric dropped, by the gaps in the numbers of each publisher and topic."""

    def __init__(self) -> None:
        self._expected: dict[tuple[str, str, object], int] = {}
        self._counts: Counter[tuple[str, str, object]] = Counter()

    def take(self, topic: str, origin: Origin, reader: object = None) -> None:
        """Take note of a message; of several readers of a topic, each has gaps of its own."""
        key = topic, origin.publisher, reader
        expected = self._expected.get(key, origin.number)
        # A number below the expected one was counted as missed, and came after its successor.
        self._counts[key] += origin.number - expected if origin.number >= expected else -1
        self._expected[key] = max(expected, origin.number + 1)
        if len(self._expected) > _PUBLISHERS_MAX:  # names are free: others may invent one for each message
            oldest = list(self._expected)[0]  # noqa: RUF015 - in one step: other topics have threads of their own
            self._expected.pop(oldest, None)
            self._counts.pop(oldest, None)

    def counts(self) -> dict[str, int]:
        """Return the numbers of messages that did not come, by topic, without those that all came.

        A publisher that repeats numbers hides no loss of another.
        """
        totals: Counter[str] = Counter()
        for (topic, *_), missing in (+self._counts.copy()).items():
            totals[topic] += missing
        return dict(sorted(totals.items()))


class _Sampled(msgspec.Struct):
    sampled_mono_ns: int


_SAMPLED: Final = msgspec.msgpack.Decoder(_Sampled)


class Rising:
    """Refuses what is no newer than a message of another publisher, for the reader of a topic.

    The gateway names one publisher for each cycle. A publisher that stood still is replaced; when it goes on, what it
    still sends is late.
    """

    def __init__(self) -> None:
        self._publisher, self._newest_ns, self._heard_s = "", 0, -math.inf

    def takes(self, publisher: str, sampled_ns: int, now_s: float) -> bool:
        """Tell whether a message that comes now, of a sampling instant, is taken."""
        if publisher != self._publisher and sampled_ns <= self._newest_ns and now_s - self._heard_s < FORGET_S:
            return False
        self._publisher, self._newest_ns, self._heard_s = publisher, sampled_ns, now_s
        return True


class Mailbox(Generic[Message]):
    """The newest messages of one topic; a slow reader loses the oldest messages, which are counted.

    Parameters
    ----------
    depth : int
        Most messages that wait.
    decode : callable, optional
        Makes a message of what was put, or None if it is no message. Messages that are lost are never decoded.
    """

    def __init__(self, depth: int, decode: Callable[[Any], Message | None] = lambda message: message) -> None:
        self.overrun = 0
        self._waiting: deque[Any] = deque(maxlen=depth)
        self._decode = decode
        # A lock that `put` opens: a condition would take several times as long to wake the reader.
        self._arrived = threading.Lock()
        self._arrived.acquire()

    def put(self, content: Any) -> None:
        """Add a message; drop the oldest when full."""
        self.overrun += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(content)
        with suppress(RuntimeError):  # open already
            self._arrived.release()

    def get(self, timeout_s: float | None = None) -> Message | None:
        """Return the oldest waiting message, or None if no message came within `timeout_s`."""
        until_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        while True:
            if (message := self._next()) is not None:
                return message
            # The lock may have been opened for a message that was taken without waiting, or is none: look again.
            if not self._arrived.acquire(timeout=-1 if timeout_s is None else max(0.0, until_s - time.monotonic())):
                return None

    def _next(self) -> Message | None:
        while self._waiting:
            if (message := self._decode(self._waiting.popleft())) is not None:
                return message
        return None


class _RingMailbox(Mailbox[Message]):
    """A mailbox that zenoh fills without the interpreter's lock: messages are seen when the reader looks.

    Parameters
    ----------
    ring : zenoh.handlers.Handler
        The samples that have come.
    is_message : callable
        Counts what is missing before a sample, and tells whether the sample is a message.
    wake : callable
        Called once, before the first wait: from then on a sample that is no message comes every `WAKE_S`.
    """

    def __init__(
        self,
        depth: int,
        decode: Callable[[Any], Message | None],
        ring: Any,
        is_message: Callable[[Any], bool],
        wake: Callable[[], None],
    ) -> None:
        super().__init__(depth, decode)
        self._ring, self._is_message, self._wake = ring, is_message, wake
        self._is_woken = False

    def get(self, timeout_s: float | None = None) -> Message | None:
        """See `Mailbox.get`."""
        until_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        with suppress(zenoh.ZError):  # the connection is closed
            while True:
                while (sample := self._ring.try_recv()) is not None:
                    self._put(sample)
                if (message := self._next()) is not None or time.monotonic() >= until_s:
                    return message
                if not self._is_woken:
                    self._is_woken = True
                    self._wake()
                self._put(self._ring.recv())
        return None

    def _put(self, sample: Any) -> None:
        if self._is_message(sample):
            self.put(sample.payload)


class Exchange(Protocol):
    """Passes messages between services: the `Fabric`, or a replay in one process."""

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        """Send a message to every subscriber of `topic`."""
        ...

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        """Return a mailbox that holds the newest `depth` messages of `topic`."""
        ...


class Shared:
    """What the services of one process share, see `Fabric.shared`: a session, and readers that need no session.

    Attributes
    ----------
    session : zenoh.Session or None
        Open from the first of the services to the last.
    readers : dict of str to list of callable
        By key: what is called with each message that a service of this process publishes, and with its origin.
    """

    def __init__(self) -> None:
        self.session: Any = None
        self.readers: defaultdict[str, list[Reader]] = defaultdict(list)
        self._lock = threading.Lock()
        self._services = 0

    def enter(self, open_session: Callable[[], Any]) -> Any:
        """Return the session for one more service."""
        if (session := self._joined(None)) is None:
            opened = open_session()  # may wait for a hub: the others are to open and leave meanwhile
            session = self._joined(opened)
            if session is not opened:  # another has opened one meanwhile
                opened.close()
        return session

    def _joined(self, opened: Any) -> Any:
        """Return the session, `opened` where there is none; count one more service where there is one now."""
        with self._lock:
            self.session = opened if self.session is None else self.session
            self._services += self.session is not None
            return self.session

    def leave(self) -> None:
        """Close the session after its last service."""
        with self._lock:
            self._services -= 1
            if self._services == 0:
                self.session.close()
                self.session = None


class Fabric:
    """Connection of one service to the other services.

    Parameters
    ----------
    skin : str
        Name of the skin; services of different skins exchange no messages.
    service : str
        Name that the others see while the connection exists; see `watch`. Several services may have the same name.
        The others do not see a program whose name is empty.
    endpoint : str
        zenoh endpoint, for example ``tcp/HOST:PORT``.
    hub : bool
        Listen on the endpoint instead of connecting to it.
    stop : Stop, optional
        If set while the constructor waits for the hub, `canskin.errors.Stopped` is raised.
    fingerprint : str
        Of this service's Φ. The other services see the fingerprint. Services of the skin with another Φ or another
        version are named in the log.
    patience_s : float
        Longest wait for the hub. By default a service waits without limit, so services start in any order.
    keys : Keys, optional
        Who the service is to the hub, or of a hub, who the hub is; default: see `environment_keys`.
    prepare : callable, optional
        Called with this connection before the others see the service: subscribes to what they send as soon as they do.

    Attributes
    ----------
    malformed : int
        Messages and requests that could not be decoded.
    missed : Missed
        Messages that did not come: this program, or its connection, was too slow.
    late : int
        Messages that were refused, see `Rising`.
    shared : Shared or None
        Of a process with several services, which sets it before the first of them is connected, and gives all of them
        the same endpoint and keys. A service without a name has a session of its own there, too.

    Raises
    ------
    BusError
        If the endpoint cannot be used, the hub refuses, no hub answered in time, this is a second gateway of its skin,
        or the role of the keys has another service. Later actions raise it, too, where the role may not do them.
    """

    shared: ClassVar[Shared | None] = None

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
        keys: Keys | None = None,
        prepare: "Callable[[Fabric], None]" = lambda _: None,
    ) -> None:
        self._shared = self.shared if service else None
        self.malformed = self.late = 0
        self.missed = Missed()
        self._peer = new_peer(skin, service, fingerprint)
        self._differences: set[str] = set()
        self._others = Roll()
        self._prefix = f"canskin/{skin}"
        self._encoder = msgspec.msgpack.Encoder()
        self._publishers: dict[str, _Publisher] = {}
        self._kept: list[Any] = []
        self._mailboxes: list[Mailbox[Any]] = []
        self._own_readers: list[tuple[list[Reader], Reader]] = []
        self._waiting: Mailbox[Any] | None = None
        keys = keys or environment_keys()
        #: Whose actions the hub allows or not: with keys, unless this is the hub, or a socket that needs no keys.
        self._holder = None if hub else checked(endpoint, keys)[1]
        if hub:
            if checked(endpoint, keys)[1] is not None:
                raise BusError(
                    f"cannot listen on {endpoint} with keys: only 'skin hub' has the rules of the roles: start it, and"
                    f" give --connect {endpoint}"
                )
            open_session = partial(open_hub, endpoint, keys, service=service)
        else:
            open_session = partial(open_client, endpoint, service, stop, patience_s, keys=keys)
        self._closed = threading.Event()
        self._clock: SkinClock | None = None
        self._token: Any = None
        self._elsewhere = zenoh.Locality.ANY if self._shared is None else zenoh.Locality.REMOTE
        self._session = open_session() if self._shared is None else self._shared.enter(open_session)
        try:
            if service:
                self.require_right("appear", service)
            self._require_alone(0.0)
            prepare(self)
            self._token = self._session.liveliness().declare_token(self._peer.key) if service else None
            self._require_alone(SETTLED_S)
        except BaseException:
            self.close()
            raise
        if keys is not None and service:
            keys.watch_end(service, self._closed)
        if fingerprint:
            self.watch_peers(self._compare)

    @property
    def instance(self) -> str:
        """What distinguishes this service from others of its name, see `canskin.peers.Peer`."""
        return self._peer.instance

    @property
    def service(self) -> str:
        """Name under which the others see this service."""
        return self._peer.service

    @property
    def overruns(self) -> int:
        """Messages that newer ones replaced in mailboxes; one of depth 1 is for the newest alone, and loses none."""
        return sum(each.overrun for each in self._mailboxes)

    def tell_scheduling(self, scheduling: str) -> None:
        """Tell the other services how this service is scheduled; see `canskin.peers.Peer`."""
        before, self._peer = self._token, msgspec.structs.replace(self._peer, scheduling=scheduling)
        self._token = self._session.liveliness().declare_token(self._peer.key)
        before.undeclare()

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        """Send `message` to every subscriber of `topic`; never waits, and a slow subscriber loses messages.

        A message is encoded and sent only where somebody reads the topic. It has a number all the same: readers whose
        connection was lost count it as missed.
        """
        publisher = self._publishers.get(topic.name) or self._new_publisher(topic)
        origin = Origin(self._peer.instance, next(publisher.numbers))
        is_sent = publisher.wire.matching_status.matching or time.monotonic() < publisher.fresh_until_s
        is_handed_over = topic in _HANDED_OVER
        content = self._encoder.encode(message) if is_sent or (publisher.readers and not is_handed_over) else b""
        if is_sent:
            publisher.wire.put(content, attachment=f"{origin.publisher}-{origin.number}")
        for read in [*publisher.readers]:  # others may come and go
            read(message if is_handed_over else content, origin)

    def subscribe(self, topic: Topic, handler: Callable[[Any], None]) -> Callable[[], None]:
        """Call `handler` with every message of `topic`, in a thread of the fabric; the handler must be quick.

        Return what ends the calls.
        """

        def take(unread: Unread) -> None:
            message = unread()
            if message is not None:
                handler(message)

        return self.subscribe_unread(topic, take)

    def subscribe_unread(self, topic: Topic, handler: Callable[[Unread], None]) -> Callable[[], None]:
        """Call `handler` with every message of `topic`, not decoded; for readers that do not need all messages.

        `malformed` counts a message that cannot be decoded when somebody reads it. Return what ends the calls.
        """
        decode = self._decoder(topic)
        return self._receive(topic, lambda content, _origin: handler(partial(decode, content)))

    def subscribe_bytes(self, topic: Topic, handler: Callable[[bytes, Origin | None], None]) -> Callable[[], None]:
        """Call `handler` with the bytes of every message of `topic`, not decoded, and its origin, if it tells one.

        Return what ends the calls.
        """

        def receive(content: Any, origin: Origin | None) -> None:
            handler(content if isinstance(content, bytes) else msgspec.msgpack.encode(content), origin)

        return self._receive(topic, receive)

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        """Return a mailbox that holds the newest `depth` messages of `topic`, for one thread."""
        decode = self._decoder(topic)
        mailbox: Mailbox[Any] = Mailbox(depth, decode)
        if self._shared is not None:
            put = mailbox.put
            self._receive(topic, lambda content, _origin: put(content), is_quick=True)
        else:
            ring = self._subscribe(topic, zenoh.handlers.RingChannel(max(depth, _KEPT_MIN))).handler
            wake = threading.Thread(target=self._wake, args=(topic,), name="mailbox").start
            is_message = partial(self._is_message, topic, Rising())
            mailbox = _RingMailbox(depth, lambda payload: decode(payload.to_bytes()), ring, is_message, wake)
        if depth > 1:
            self._mailboxes.append(mailbox)
        return mailbox

    def answer(self, question: Question, handler: Callable[[Any, Reply], None]) -> None:
        """Call ``handler(request, reply)`` with every request, in a thread of the fabric.

        The handler, or another thread later, calls `reply` once with the answer. Requests that cannot be decoded are
        counted in `malformed`.
        """
        self.require_right("answer", question.name)
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
                    tell(self._peer.service, f"an answer to '{question.name}' is lost: {first_sentence(error)}")

            handler(request, reply)

        self._kept.append(self._session.declare_queryable(f"{self._prefix}/{question.name}", receive))

    def ask(self, question: Question, request: msgspec.Struct, timeout_s: float) -> Any:
        """Return the answer to a request.

        Raises
        ------
        BusError
            If no service answers in time, or the answer cannot be decoded.
        """
        self.require_right("ask", question.name)
        key, payload = f"{self._prefix}/{question.name}", self._encoder.encode(request)
        # Without consolidation: the first answer counts, while another service may hang.
        each = zenoh.ConsolidationMode.NONE
        for reply in self._session.get(key, payload=payload, timeout=timeout_s, consolidation=each):
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
            if peer.skin == self._peer.skin and there.note(peer.service, peer.key, alive):
                changed(peer.service, there.holds(peer.service))

        self.watch_peers(note)

    def watch_peers(self, changed: Callable[[Peer, bool], None]) -> None:
        """Call ``changed(peer, alive)`` for every service of every skin on the hub that is present, comes or goes."""

        def receive(sample: Any) -> None:
            peer = peer_of_key(str(sample.key_expr))
            if peer is None:
                self.malformed += 1
            else:
                changed(peer, sample.kind == zenoh.SampleKind.PUT)

        self._kept.append(self._session.liveliness().declare_subscriber(EVERY_KEY, receive, history=True))

    def peers(self) -> list[Peer]:
        """Return the services of all skins that are on the hub now; with a name of its own not at once all of them."""
        return peers_of(self._session)

    def clock(self, of: str = "") -> SkinClock:
        """Return the clock of the skin, which a thread follows from now on.

        Parameters
        ----------
        of : str, optional
            `canskin.skin_clock.machine` of the gateway, if it is known.
        """
        clock = self._clock = SkinClock(of)
        ask = partial(self.ask, TIME, TimeRequest(), CLOCK_S)

        def follow() -> None:
            while threading.main_thread().is_alive() and not self._closed.wait(clock.period_s):
                with suppress(zenoh.ZError):  # the connection is closed now
                    clock.look(ask)

        if clock.known()[1] != 0:  # not this machine, or unknown
            clock.look(ask)
        threading.Thread(target=follow, name="clock").start()
        return clock

    @property
    def clock_ns(self) -> tuple[int, int]:
        """Offset and error of `clock`, see `canskin.messages.ServiceStatus`."""
        return (0, UNKNOWN_ERROR_NS) if self._clock is None else self._clock.known()

    def close(self) -> None:
        """Close the connection after all published messages are sent."""
        self._closed.set()
        if self._shared is None:
            self._session.close()
            return
        for readers, read in self._own_readers:
            readers.remove(read)
        if self._waiting is not None:
            self._waiting.put(lambda: None)  # the thread looks whether to end
        for each in (*self._kept, *(publisher.wire for publisher in self._publishers.values()), self._token):
            if each is not None:
                each.undeclare()
        self._shared.leave()

    def require_right(self, action: Action, name: str) -> None:
        """Raise DeniedError if the hub will not let the holder of these keys do an action: zenoh says nothing."""
        holder = self._holder
        if holder is None:
            return
        why = f"they are of skin '{holder.skin}', not of '{self._peer.skin}'" if holder.skin != self._peer.skin else ""
        if why := why or refusal(holder.role, action, name):
            raise DeniedError(f"keys {holder.folder}: {why}")

    def _require_alone(self, patience_s: float) -> None:
        """Raise BusError if this is a second gateway of its skin.

        Of two that start at once, the one of the lowest instance waits, and the other leaves.
        """
        own, give_up_s = self._peer, time.monotonic() + patience_s
        while own.service in GATEWAYS:
            others = [each for each in self.peers() if each.skin == own.skin and each.service in GATEWAYS]
            rivals = [each for each in others if each.instance != own.instance]
            if not rivals:
                return
            if min(each.instance for each in rivals) < own.instance or time.monotonic() >= give_up_s:
                raise BusError(
                    f"skin '{own.skin}' has a {rivals[0].service} already: stop that first, or give this skin another"
                    " name in its layout"
                )
            time.sleep(LOOK_S)

    def _new_publisher(self, topic: Topic) -> "_Publisher":
        self.require_right("put", topic.name)
        # Never BLOCK: a subscriber that hangs would delay the gateway's SYNC for seconds.
        key, control = f"{self._prefix}/{topic.name}", zenoh.CongestionControl.DROP
        wire = self._session.declare_publisher(key, congestion_control=control, allowed_destination=self._elsewhere)
        readers = [] if self._shared is None else self._shared.readers[key]
        publisher = _Publisher(wire, count(1), time.monotonic() + FRESH_S, readers)
        self._publishers[topic.name] = publisher
        return publisher

    def _subscribe(self, topic: Topic, handler: Any) -> Any:
        self.require_right("subscribe", topic.name)
        subscriber = self._session.declare_subscriber(
            f"{self._prefix}/{topic.name}", handler, allowed_origin=self._elsewhere
        )
        self._kept.append(subscriber)
        return subscriber

    def _receive(
        self, topic: Topic, receive: Callable[[Any, Origin | None], None], *, is_quick: bool = False
    ) -> Callable[[], None]:
        """Call `receive` with the bytes of every message and its origin; of this process, with the message itself.

        A message of this process comes in the thread that publishes where `receive` is quick, else in another: a
        publisher, such as the gateway, waits for no reader. Return what ends the calls.
        """
        rising = Rising()

        def take(content: Any, origin: Origin | None) -> None:
            if self._is_in_time(topic, rising, content, origin):
                receive(content, origin)

        def take_sample(sample: Any) -> None:
            origin = self._note(topic, rising, sample)
            if len(sample.payload) > 0:
                take(sample.payload.to_bytes(), origin)

        subscriber, own = self._subscribe(topic, take_sample), None
        if self._shared is not None:
            own = self._shared.readers[f"{self._prefix}/{topic.name}"], take if is_quick else self._queued(take)
            self._own_readers.append(own)
            own[0].append(own[1])

        def end() -> None:
            self._kept.remove(subscriber)
            subscriber.undeclare()
            if own is not None:
                self._own_readers.remove(own)
                own[0].remove(own[1])

        return end

    def _queued(self, receive: Reader) -> Reader:
        """Return what has `receive` called in a thread of this connection."""
        if self._waiting is None:
            self._waiting = Mailbox(_WAITING_MAX)
            self._mailboxes.append(self._waiting)
            threading.Thread(target=self._hand_over, args=(self._waiting,), name=f"to {self.service}").start()
        waiting = self._waiting
        return lambda content, origin: waiting.put(partial(receive, content, origin))

    def _hand_over(self, waiting: Mailbox[Any]) -> None:
        while not self._closed.is_set():
            if (read := waiting.get()) is not None:
                try:
                    read()
                except Exception as error:  # noqa: BLE001  as zenoh, which goes on with the next message
                    tell(self.service, f"a message was not taken: {type(error).__name__}: {error}", logging.ERROR)

    def _note(self, topic: Topic, reader: object, sample: Any) -> Origin | None:
        """Count what is missing for a reader before a sample, and return its origin."""
        origin = _origin_of(sample.attachment)
        if origin is not None:
            self.missed.take(topic.name, origin, reader)
        return origin

    def _is_message(self, topic: Topic, rising: Rising, sample: Any) -> bool:
        """Count what is missing before a sample; tell whether the sample is more than that of `_wake`, and in time."""
        origin = self._note(topic, rising, sample)
        return len(sample.payload) > 0 and self._is_in_time(topic, rising, sample.payload, origin)

    def _is_in_time(self, topic: Topic, rising: Rising, content: Any, origin: Origin | None) -> bool:
        """Tell whether a reader takes a message: its bytes, zenoh's payload, or the message itself."""
        if topic not in _MADE_OF_CYCLES or origin is None:
            return True
        try:
            is_message = isinstance(content, msgspec.Struct)
            sampled_ns = (content if is_message else _SAMPLED.decode(bytes(content))).sampled_mono_ns
        except UNDECODABLE:  # counted when it is read
            return True
        is_in_time = rising.takes(origin.publisher, sampled_ns, time.monotonic())
        self.late += not is_in_time
        return is_in_time

    def _wake(self, topic: Topic) -> None:
        """Send whoever waits for messages of a topic in this process an empty sample: a wait of zenoh has no end."""
        while threading.main_thread().is_alive() and not self._closed.wait(WAKE_S):
            with suppress(zenoh.ZError):  # the connection is closed now
                here = zenoh.Locality.SESSION_LOCAL
                self._session.put(f"{self._prefix}/{topic.name}", b"", allowed_destination=here)

    def _decoder(self, topic: Topic) -> Callable[[bytes], Any]:
        """Return what decodes a message of `topic`, or returns None and counts it in `malformed`.

        A message that was handed over stays as it is.
        """
        decode = topic.decoder()

        def decode_or_count(content: Any) -> Any:
            try:
                return decode(content) if isinstance(content, bytes) else content
            except UNDECODABLE:
                self.malformed += 1
                return None

        return decode_or_count

    def _compare(self, peer: Peer, alive: bool) -> None:
        """Log services of this skin that come and go, and once per difference that one cannot work with this one."""
        if peer.instance == self._peer.instance or peer.skin != self._peer.skin:
            return
        if self._others.note(peer.service, peer.key, alive):
            tell(self._peer.service, f"{peer.service} {'is there' if alive else 'has left'}", logging.INFO)
        difference = self._peer.difference(peer) if alive else ""
        if difference and difference not in self._differences and len(self._differences) < _DIFFERENCES_MAX:
            self._differences.add(difference)
            tell(self._peer.service, difference)


def _origin_of(attachment: Any) -> Origin | None:
    """Return what an attachment tells; other programs attach nothing, or something else."""
    if attachment is None:
        return None
    publisher, _, number = attachment.to_bytes().partition(b"-")
    is_told = publisher.isalnum() and len(publisher) <= 64 and number.isdigit() and len(number) <= 18
    return Origin(publisher.decode(), int(number)) if is_told else None
