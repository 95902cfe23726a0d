"""The model: all that a snapshot shows is of one instant, in whatever order messages come."""

from collections import defaultdict
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from health.state import HELD_S, ViewState
from tests.health.helpers import Messages

CYCLES: Final = 12
PERIOD_S: Final = 0.01
TOPICS: Final = ("image", "contacts", "label", "truth")
#: No message is later than this, so no image is shown before all of it is there.
LATEST_S: Final = 0.9 * HELD_S
MESSAGES: Final = Messages()


@cache
def message(topic: str, cycle: int) -> msgspec.Struct:
    """Return a message from which the cycle can be read: forces are the cycle's number."""
    pixels = {"image": {"pixels": MESSAGES.grid(cycle)}, "truth": {"true": MESSAGES.grid(cycle)}}.get(topic, {})
    made: msgspec.Struct = getattr(MESSAGES, topic)(cycle=cycle, sync_s=1 + cycle * PERIOD_S, **pixels)
    return made


def cycle_of(picture: Any) -> int | None:
    return None if picture is None else round(float(picture.max() / MESSAGES.grid(1.0).max()))


def arrivals(late_s: st.SearchStrategy[float | None]) -> st.SearchStrategy[dict[str, list[float | None]]]:
    return st.fixed_dictionaries(dict.fromkeys(TOPICS, st.lists(late_s, min_size=CYCLES, max_size=CYCLES)))


late_s = st.floats(0, LATEST_S)


@given(lags=arrivals(late_s) | arrivals(late_s | st.none()), looks=st.lists(st.floats(0, 0.4), max_size=8))
def test_a_snapshot_never_mixes_instants(lags: dict[str, list[float | None]], looks: list[float]) -> None:
    """Messages of a topic come in their order, each as late as drawn, or never."""
    state = ViewState(MESSAGES.layout)
    events: list[tuple[float, str, int]] = [(at_s, "", 0) for at_s in looks]
    has_all = all(None not in drawn for drawn in lags.values())
    for topic, drawn in lags.items():
        state.take(message(topic, 0), 0.0)
        at_s = 0.0
        for cycle, lag_s in enumerate(drawn, 1):
            if lag_s is not None:
                at_s = max(at_s, cycle * PERIOD_S + lag_s)
                events.append((at_s, topic, cycle))
    came, newest = defaultdict(lambda: {0}), 0
    for at_s, topic, cycle in sorted(events):
        if topic:
            state.take(message(topic, cycle), at_s)
            came[topic].add(cycle)
        snapshot, pictures = state.snapshot(at_s)
        image, contacts, label, truth = snapshot.image, snapshot.contacts, snapshot.label, snapshot.truth
        assert image is not None
        shown = image.cycle
        assert newest <= shown
        newest = shown
        assert cycle_of(pictures.image) == shown
        assert (contacts and contacts.cycle) == (shown if shown in came["contacts"] else None)
        assert (truth and truth.step) == cycle_of(pictures.true) == (shown if shown in came["truth"] else None)
        assert label is not None
        assert label.cycle == max(each for each in came["label"] if each <= shown)
        assert snapshot.moment.force_n == pytest.approx(snapshot.patches[0].force_n)
        assert snapshot.moment.force_n == pytest.approx(float(np.sum(pictures.image)), rel=1e-4)
        assert not has_all or (contacts and truth and label.cycle == shown)


def test_an_image_waits_no_longer_than_a_tenth_of_a_second_for_the_others() -> None:
    state = ViewState(MESSAGES.layout)
    for topic in TOPICS:
        state.take(message(topic, 0), 1.0)
    state.take(message("image", 1), 1.1)
    for now_s, cycle in ((1.1 + 0.9 * HELD_S, 0), (1.1 + 1.1 * HELD_S, 1)):
        snapshot, _ = state.snapshot(now_s)
        assert snapshot.image is not None
        assert snapshot.image.cycle == cycle
    assert (snapshot.contacts, snapshot.truth) == (None, None)
    state.take(message("contacts", 1), 1.3)
    assert state.snapshot(1.3)[0].contacts is not None


def test_labels_go_on_without_images() -> None:
    state = ViewState(MESSAGES.layout)
    state.take(message("image", 0), 1.0)
    for cycle, at_s in ((1, 1.1), (5, 2.0)):
        state.take(message("label", cycle), at_s)
    label = state.snapshot(2.0)[0].label
    assert label is not None
    assert (label.cycle, label.stale) == (5, False)
