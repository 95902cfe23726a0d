"""The page of a skin with steps: images come when there is news, a thousand a second or ten."""

from typing import Any

import msgspec
import pytest

from canskin.messages import Image, Truth
from health.state import ViewState
from skin.layout import Bus, Layout, PhiParameters, Sampling, Sync, Taxels
from tests.health.helpers import note, seen_of
from views.page.wire import greeting

LAYOUT = Layout(
    name="palm",
    sending="steps",
    taxels=Taxels(rows=16, columns=16),
    measurement=PhiParameters(wiring="board", sums=256),
    sync=Sync(rate_hz=10.0),
    sampling=Sampling(rate_hz=1000.0),
    bus=[Bus(name="left", nodes=4), Bus(name="right", nodes=4)],
)


@pytest.fixture
def state() -> ViewState:
    return ViewState(LAYOUT)


def image(messages: Any, at_s: float, force_n: float = 0.01) -> Image:
    made: Image = messages.image(1, sync_s=at_s - 0.003, latency_s=0.003, pixels=messages.grid(force_n))
    return made


def truth(messages: Any, at_s: float, force_n: float = 0.01) -> Truth:
    made = messages.truth(1, sync_s=at_s, true=messages.grid(force_n))
    return msgspec.structs.replace(made, sync_counter=0, step=round(100 * at_s))


def test_a_quiet_skin_is_not_stale(state: ViewState, messages: Any) -> None:
    note(state, "reconstructor", True, 0.0)
    for each in range(10, 60):
        state.take(image(messages, each / 10), each / 10)
    snapshot = seen_of(state, 5.99)
    assert snapshot.image is not None
    assert not snapshot.image.stale
    assert snapshot.figures.images_hz == pytest.approx(10, abs=1)
    assert not [notice for notice in snapshot.notices if notice.level == "error"]


def test_an_image_without_new_sums_has_no_latency(state: ViewState, messages: Any) -> None:
    one = image(messages, 1.0)
    for each in range(5):
        again = msgspec.structs.replace(one, published_mono_ns=one.published_mono_ns + 100_000_000 * each)
        state.take(again, 1.0 + each / 10)
    figures = seen_of(state, 1.4).figures
    assert figures.latency_p99_s == pytest.approx(0.003)
    assert figures.images_hz == pytest.approx(10)


def test_a_thousand_images_a_second_are_counted(state: ViewState, messages: Any) -> None:
    one = image(messages, 1.0)
    for each in range(6000):
        times_ns = {"sampled_mono_ns": 1_000_000 * each, "published_mono_ns": 1_000_000 * (each + 3)}
        state.take(msgspec.structs.replace(one, **times_ns), each / 1e3)
    figures = seen_of(state, 6.0).figures
    assert figures.images_hz == pytest.approx(1000, abs=2)
    assert figures.latency_p99_s == pytest.approx(0.003)


def test_psnr_is_that_of_the_image_on_show(state: ViewState, messages: Any) -> None:
    state.take(image(messages, 0.98, 0.02), 0.98)
    state.take(image(messages, 0.99, 0.012), 0.99)
    state.take(truth(messages, 1.0), 1.001)
    assert seen_of(state, 1.002).figures.psnr_image_db is None  # an image of that time may be on its way
    state.take(image(messages, 1.005, 0.02), 1.005)
    psnr_db = seen_of(state, 1.01).figures.psnr_image_db
    assert psnr_db == pytest.approx(34, abs=8)
    assert psnr_db is not None
    other = ViewState(LAYOUT)
    other.take(image(messages, 0.99, 0.02), 0.99)
    other.take(truth(messages, 1.0), 1.0)
    other.take(image(messages, 1.005), 1.005)
    worse_db = seen_of(other, 1.01).figures.psnr_image_db
    assert worse_db == pytest.approx(psnr_db - 14, abs=0.1)


def test_the_truth_shown_is_that_of_the_images_time(state: ViewState, messages: Any) -> None:
    for each in (1.0, 1.01, 1.02):
        state.take(truth(messages, each), each)
    state.take(image(messages, 1.012), 1.013)
    shown = seen_of(state, 1.03).truth
    assert shown.step == 101


def test_greeting_says_how_the_skin_sends(messages: Any) -> None:
    assert greeting(LAYOUT)["sending"] == "steps"
    assert greeting(messages.layout)["sending"] == "synchronous"
