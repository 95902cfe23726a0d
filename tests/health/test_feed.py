"""One feed for all who show a skin: nothing is left out, or all but the newest messages."""

from functools import partial
from typing import Any

import msgspec
import pytest

from canskin.messages import IMAGE, LABEL
from canskin.peers import Peer
from health.feed import UNREAD_S, Feed
from tests.health.helpers import FabricStub
from tests.messages import label


@pytest.mark.parametrize("newest", [False, True])
def test_messages_and_peers_are_given_in_the_order_in_which_they_came(newest: bool) -> None:
    fabric, now_s, given = FabricStub(), [0.0], list[Any]()

    def note(*each: Any) -> None:
        given.append(each)

    feed = Feed(fabric.fabric, (IMAGE, LABEL), note, note, newest=newest, clock_s=lambda: now_s[0])
    peer, came = Peer("palm", "classifier", "1"), list[tuple[msgspec.Struct, float]]()
    for number in range(5):
        for topic in ("label", "image"):
            now_s[0] += 0.01
            came.append((label(number, topic), now_s[0]))
            fabric.handlers[topic](partial(label, number, topic))
    fabric.handlers["label"](lambda: None)  # it cannot be decoded
    fabric.changed(peer, True)
    assert given == []
    assert feed.read() == now_s[0]
    assert given == [*(came[-1:] if newest else came), (peer, True, now_s[0])]
    feed.read()
    assert len(given) == 1 + (1 if newest else len(came))


@pytest.mark.parametrize("newest", [False, True])
def test_what_nobody_reads_is_taken_soon_unless_the_newest_is_enough(newest: bool) -> None:
    fabric, now_s, given = FabricStub(), [0.0], list[Any]()
    Feed(fabric.fabric, (LABEL,), lambda *each: given.append(each), print, newest=newest, clock_s=lambda: now_s[0])
    for now_s[0] in (0.0, UNREAD_S, 1.01 * UNREAD_S):
        assert given == []
        fabric.handlers["label"](partial(label, 1, "cup"))
    assert len(given) == (0 if newest else 3)
