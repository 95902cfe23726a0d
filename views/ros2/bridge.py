"""From a skin's fabric to ROS 2: the newest message of each topic, and a service for the zero."""

import time
from collections.abc import Callable
from functools import partial
from typing import Final

import msgspec

from canskin.calibration_messages import ANSWER_S, CALIBRATION, CalibrationReply, CalibrationRequest
from canskin.fabric import Fabric
from health.feed import Feed
from health.state import ViewState
from shell.pulse import Beat, unheard
from shell.service import LOOK_S, StopSignal
from skin.layout import Layout
from views.ros2.node import SERVICE, RosNode
from views.ros2.topics import DIAGNOSTIC_ARRAY, SKIN_TOPICS, Translator, topics_of

#: Period of diagnostics, that of `diagnostic_updater`.
DIAGNOSTICS_S: Final = 1.0
TARE: Final = "tare"


class Bridge:
    """Publishes a skin on ROS 2.

    Parameters
    ----------
    fabric : Fabric
        Of the skin.
    frame : str
        Frame of the messages.
    clock_s : callable
        Monotonic clock.
    """

    def __init__(
        self,
        layout: Layout,
        fabric: Fabric,
        node: RosNode,
        frame: str,
        *,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._state = ViewState(layout, time.time() - clock_s(), SERVICE)
        self._translator = Translator(layout, frame, self._state)
        self._publishers = {topic: node.publisher(topic) for topic in topics_of(layout)}
        self._due_s = clock_s()
        node.serve_trigger(TARE, partial(tare, fabric))
        self._feed = Feed(fabric, SKIN_TOPICS, self._publish, self._state.take_peer, newest=True, clock_s=clock_s)

    def run(self, stop: StopSignal, beat: Beat = unheard) -> None:
        """Publish until `stop`."""
        while not stop.is_set():
            self.turn(LOOK_S)
            beat(0)

    def turn(self, timeout_s: float) -> None:
        """Publish what waits; wait for messages at most `timeout_s`."""
        now_s = self._feed.read(timeout_s)
        if now_s >= self._due_s:
            self._due_s = now_s + DIAGNOSTICS_S
            told = self._translator.diagnostics(now_s, time.time_ns(), self._feed.malformed)
            self._publishers[DIAGNOSTIC_ARRAY].publish(told)

    def _publish(self, message: msgspec.Struct, at_s: float) -> None:
        for topic, make in self._translator.take(message, at_s):
            publisher = self._publishers[topic]
            if publisher.has_readers:
                publisher.publish(make())


def tare(fabric: Fabric) -> tuple[bool, str]:
    """Have the gateway measure the zero of the skin anew; return whether there is a new zero, and words.

    Raises
    ------
    BusError
        If no gateway answers.
    """
    reply: CalibrationReply = fabric.ask(CALIBRATION, CalibrationRequest(action="tare"), ANSWER_S)
    return reply.is_done, reply.text
