"""The newest messages wait, and no others."""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import pytest

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


@pytest.mark.parametrize("depth", [1, 3])
def test_only_the_newest_messages_of_a_topic_wait(depth: int) -> None:
    fabric = FabricStub()
    arrivals = Arrivals(cast("Fabric", fabric), (IMAGE, LABEL), depth)
    for number in range(5):
        fabric.handlers["image"](partial(label, 1, f"image {number}"))
        fabric.handlers["label"](partial(label, 1, f"label {number}"))
    kept = range(5 - depth, 5)
    assert arrivals.take(0.0) == [label(1, f"{each} {number}") for each in ("image", "label") for number in kept]
    assert arrivals.skipped == 2 * (5 - depth)
    assert arrivals.take(0.0) == []
