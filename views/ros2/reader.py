"""A reader of topics of ROS 2 on the wire of rmw_zenoh."""

from collections.abc import Callable
from typing import Any

from canskin.session import close_with_program, open_client
from views.ros2.names import Node
from views.ros2.node import ROUTER
from views.ros2.types import decoded, key_type


class RosReader:
    """Subscribes to topics.

    Parameters
    ----------
    router : str
        zenoh endpoint of the ROS network's router.
    patience_s : float
        Longest wait for the router.

    Raises
    ------
    BusError
        If the endpoint cannot be used, or nobody answered in time.
    """

    def __init__(self, router: str, *, domain: int = 0, patience_s: float = 5.0) -> None:
        self._session = open_client(router, "ROS 2 reader", None, patience_s, ROUTER)
        self._node = Node(domain, str(self._session.info.zid()), "/", "reader")
        self._kept: list[Any] = []
        close_with_program(self.close)

    def subscribe(self, name: str, ros_type: str, handler: Callable[[Any], None]) -> None:
        """Call `handler` with every message of a topic, in a thread of zenoh."""

        def receive(sample: Any) -> None:
            handler(decoded(ros_type, sample.payload.to_bytes()))

        self._kept.append(self._session.declare_subscriber(self._node.data_key(name, key_type(ros_type)), receive))

    def close(self) -> None:
        """Leave the network."""
        self._session.close()
