"""The newest messages wait, and no others."""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

from canskin.fabric import Fabric, Unread
from canskin.messages import IMAGE, LABEL, Topic
from health.arrivals import Arrivals
from tests.messages import label


class FabricStub:
    """Keeps the handlers."""

    def __init__(self) -> None:
        self.handlers: dict[str, Callable[[Unread], None]] = {}

    def subscribe_unread(self, topic: Topic, handler: Callable[[Unread], None]) -> None:
        self.handlers[topic.name] = handler

    def watch_peers(self, changed: Callable[[Any, bool], None]) -> None:
        pass


def test_only_the_newest_message_of_a_topic_waits() -> None:
    fabric = FabricStub()
    arrivals = Arrivals(cast("Fabric", fabric), (IMAGE, LABEL))
    for number in range(5):
        fabric.handlers["image"](partial(label, 1, f"image {number}"))
        fabric.handlers["label"](partial(label, 1, f"label {number}"))
    assert arrivals.take(0.0) == [label(1, "image 4"), label(1, "label 4")]
    assert arrivals.skipped == 8
    assert arrivals.take(0.0) == []
