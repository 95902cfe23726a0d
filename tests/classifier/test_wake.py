"""A touch asks for images, as the layout says, once in half of the time for which they come."""

import threading
from typing import Literal

import pytest

from canskin.errors import BusError, RunError
from canskin.messages import UNKNOWN_OBJECT
from classifier.wake import RENEW, Wake
from skin.layout import Recognition

What = Literal["contact", "label", "request"]


class Gateway:
    """Takes requests; the first of them may fail."""

    def __init__(self, refused: int = 0, error: type[Exception] = BusError) -> None:
        self._error = error
        self.asked: list[float] = []
        self.came = threading.Semaphore(0)
        self._refused = refused

    def __call__(self, hold_s: float) -> None:
        self.asked.append(hold_s)
        self.came.release()
        if len(self.asked) <= self._refused:
            raise self._error("nobody")


def waking(wake: What, gateway: Gateway, now_s: list[float]) -> Wake:
    return Wake(Recognition(rate_hz=500.0, sums=64, wake=wake, hold_s=2.0), gateway, lambda: now_s[0])


@pytest.mark.parametrize(
    ("wake", "labels"),
    [("contact", ["ring", UNKNOWN_OBJECT]), ("label", ["ring"]), ("request", [])],
)
def test_what_wakes(wake: What, labels: list[str]) -> None:
    gateway, now_s = Gateway(), [0.0]
    made = waking(wake, gateway, now_s)
    assert [label for label in ("", UNKNOWN_OBJECT, "ring") if made.wants(label, 0.0)] == list(reversed(labels))
    for label in labels:
        now_s[0] += 10
        made.take(label)
        assert gateway.came.acquire(timeout=240)
    made.close()
    assert gateway.asked == [2.0] * len(labels)


def test_a_touch_that_goes_on_renews_the_request() -> None:
    gateway, now_s = Gateway(), [0.0]
    made = waking("contact", gateway, now_s)
    for _ in range(4):
        made.take("ring")
        assert gateway.came.acquire(timeout=240)
        made.take("ring")  # within the time of the request
        now_s[0] += 2.0 * RENEW
    made.close()
    assert len(gateway.asked) == 4


@pytest.mark.parametrize("error", [BusError, RunError, ValueError])
def test_after_a_failure_that_is_told_once_the_next_label_asks_again(
    error: type[Exception], capsys: pytest.CaptureFixture[str]
) -> None:
    gateway, now_s = Gateway(refused=2, error=error), [0.0]
    made = waking("contact", gateway, now_s)
    made.take("ring")
    assert gateway.came.acquire(timeout=240)
    for _ in range(1000):
        made.take("ring")
        gateway.came.acquire(timeout=0.01)
        if len(gateway.asked) == 3:
            break
    made.close()
    assert len(gateway.asked) == 3
    assert capsys.readouterr().err.count("no images: nobody") == 1
