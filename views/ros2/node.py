"""A node of ROS 2 on a zenoh session: publishers and services that rmw_zenoh sees."""

import threading
import time
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any, Final

import zenoh

from canskin.session import Listener, open_client
from shell.service import RateLimitedLog, StopSignal
from views.ros2.names import RELIABLE, Node, attachment, gid_of, parse_attachment
from views.ros2.topics import RosTopic
from views.ros2.types import TRIGGER, TRIGGER_REPLY, encoded, key_type, message

#: Where the router of a ROS network listens.
ROUTER: Final = Listener(
    "router", "the ROS network's router", "'ros2 run rmw_zenoh_cpp rmw_zenohd'", "--router"
)  # fmt: skip
SERVICE: Final = "ros2"


class RosNode:
    """A node with publishers and services.

    Parameters
    ----------
    router : str
        zenoh endpoint of the ROS network's router.
    domain : int
        ``ROS_DOMAIN_ID`` of the network.
    namespace, name : str
        Of the node.
    stop : StopSignal, optional
        If set while the constructor waits for the router, `canskin.errors.Stopped` is raised.
    has_hashes : bool
        Keys have type hashes: all distributions but Humble.

    Raises
    ------
    BusError
        If the endpoint cannot be used.
    """

    def __init__(
        self,
        router: str,
        *,
        domain: int,
        namespace: str,
        name: str,
        stop: StopSignal | None = None,
        has_hashes: bool = True,
    ) -> None:
        self._has_hashes = has_hashes
        self._session = open_client(router, SERVICE, stop, listener=ROUTER)
        self.node = Node(domain, str(self._session.info.zid()), namespace, name)
        self._log = RateLimitedLog(SERVICE)
        self._is_closed = False
        self._requests: SimpleQueue[Callable[[], None]] = SimpleQueue()
        # A daemon: the end of the process does not wait for an answer, which may take many seconds.
        threading.Thread(target=self._serve, name="ROS 2 service", daemon=True).start()
        self._kept: list[Any] = [self._session.liveliness().declare_token(self.node.token)]
        self._endpoints = 0

    def publisher(self, topic: RosTopic) -> "RosPublisher":
        """Return a publisher of a topic."""
        name, wire_type = self.node.full_name(topic.name), key_type(topic.ros_type, has_hash=self._has_hashes)
        self._endpoints += 1
        token = self.node.endpoint_token(self._endpoints, "MP", name, wire_type, topic.qos)
        wire = self._session.declare_publisher(
            self.node.data_key(name, wire_type),
            # Reliable, too: a reader that hangs must not hold up the others.
            congestion_control=zenoh.CongestionControl.DROP,
            reliability=zenoh.Reliability.BEST_EFFORT if topic.qos.best_effort else zenoh.Reliability.RELIABLE,
        )
        self._kept += [wire, self._session.liveliness().declare_token(token)]
        return RosPublisher(wire, topic.ros_type, gid_of(token))

    def serve_trigger(self, name: str, act: Callable[[], tuple[bool, str]]) -> None:
        """Offer a ``std_srvs/srv/Trigger``; `act` tells success and message, in a thread of its own.

        An exception of `act` is an answer without success.
        """
        full_name, wire_type = self.node.full_name(name), key_type(TRIGGER, has_hash=self._has_hashes)
        self._endpoints += 1

        def receive(query: Any) -> None:
            asked = parse_attachment(query.attachment.to_bytes()) if query.attachment is not None else None
            if asked is None:
                self._log.say(f"a request to {full_name} has no attachment of rmw_zenoh, and is not answered")
                return
            self._requests.put(partial(self._answer, query, asked, act))

        key = self.node.data_key(full_name, wire_type)
        token = self.node.endpoint_token(self._endpoints, "SS", full_name, wire_type, RELIABLE)
        self._kept += [
            self._session.declare_queryable(key, receive, complete=True),
            self._session.liveliness().declare_token(token),
        ]

    def close(self) -> None:
        """Leave the network; requests without an answer get none."""
        self._is_closed = True
        self._requests.put(lambda: None)
        self._session.close()

    def _serve(self) -> None:
        """Answer one request after the other, until the node is closed."""
        while not self._is_closed:
            self._requests.get()()

    def _answer(self, query: Any, asked: tuple[int, int, bytes], act: Callable[[], tuple[bool, str]]) -> None:
        number, _, gid = asked
        try:
            is_done, words = act()
        except Exception as error:  # noqa: BLE001 - whatever happened, the caller waits for an answer
            is_done, words = False, str(error) or type(error).__name__
        if self._is_closed:
            return
        content = encoded(TRIGGER_REPLY, message(TRIGGER_REPLY, success=is_done, message=words))
        try:
            query.reply(query.key_expr, content, attachment=attachment(number, time.time_ns(), gid))
            query.drop()
        except zenoh.ZError as error:  # the asker may have left
            self._log.say(f"an answer is lost: {error}")


class RosPublisher:
    """Publishes messages of one topic.

    Attributes
    ----------
    published : int
        Number of messages so far, which every attachment tells.
    """

    def __init__(self, wire: Any, ros_type: str, gid: bytes) -> None:
        self.published = 0
        self._wire, self._ros_type, self._gid = wire, ros_type, gid

    @property
    def has_readers(self) -> bool:
        """Whether anybody has subscribed to the topic."""
        return bool(self._wire.matching_status.matching)

    def publish(self, content: Any) -> None:
        """Send a message; never waits, and a slow reader loses messages."""
        self.published += 1
        self._wire.put(
            encoded(self._ros_type, content), attachment=attachment(self.published, time.time_ns(), self._gid)
        )
