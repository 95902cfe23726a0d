"""A reconstructor that stands by goes on where another one has stopped: the same image, number and contacts."""

from collections.abc import Iterator
from itertools import count
from typing import Any

import msgspec
import numpy as np
import pytest

from reconstructor.imaging import make_imager
from reconstructor.service import ReconstructorService
from tests.messages import Published
from tests.reconstructor.helpers import LAYOUT, Scene, measurement, pixels

#: Two reconstructors' images differ by less than this `ALIKE_CYCLES` after the younger one's start, newtons: a tenth of
#: an image's error.
ALIKE_N = 5e-5
ALIKE_CYCLES = 50
EVERYBODY = "everybody"
NOTHING = np.zeros((64, 64))


class Stage:
    """Reconstructors that hear the same measurements, and each the contacts of the others."""

    def __init__(self) -> None:
        self.cycle = 0
        self._fabrics: dict[str, Published] = {}
        self._services: dict[str, ReconstructorService] = {}

    def start(self, instance: str) -> None:
        self._fabrics[instance] = fabric = Published()
        self._services[instance] = ReconstructorService(LAYOUT, make_imager(LAYOUT), fabric, instance=instance)

    def publish(self, force_n: np.ndarray, named: str) -> dict[str, Any]:
        """Measure forces; return the image and the contacts of each that publishes."""
        self.cycle += 1
        duty = "" if named == EVERYBODY else f"reconstructor={named}"
        told = measurement(self.cycle, force_n)
        told = msgspec.structs.replace(told, sampled_mono_ns=10_000_000 * self.cycle, duty=duty)
        published = {}
        for instance, service in self._services.items():
            service.take(told)
            if messages := self._fabrics[instance].messages:
                published[instance] = tuple(messages)
                for fabric in self._fabrics.values():
                    for mailbox in fabric.mailboxes[1:]:
                        mailbox.put(messages[-1])
                messages.clear()
        return published


@pytest.fixture
def noisy(golf: Scene) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(1)
    return (np.clip(golf.true[30] + rng.normal(0, 1e-3, (64, 64)), 0, 0.02) for _ in count())


@pytest.mark.heavy
def test_who_takes_over_goes_on_with_image_number_and_contacts(golf: Scene, noisy: Iterator[np.ndarray]) -> None:
    stage = Stage()
    stage.start("first")
    elsewhere = np.roll(golf.true[30], (30, 30), (0, 1))
    for force_n in (elsewhere, *10 * [NOTHING], elsewhere, *10 * [NOTHING], *(next(noisy) for _ in range(20))):
        stage.publish(force_n, "first")
    stage.start("second")
    for _ in range(ALIKE_CYCLES):
        published = stage.publish(next(noisy), "first")
        assert list(published) == ["first"]
    before = published["first"]
    after = stage.publish(next(noisy), "second")
    assert list(after) == ["second"]
    image, contacts = after["second"]
    assert image.number == contacts.number
    assert image.cycle - before[0].cycle == image.number - before[0].number
    (old,), (new,) = before[1].contacts, contacts.contacts
    assert (new.identity, new.onset_mono_ns) == (old.identity, old.onset_mono_ns)
    assert new.identity == 3
    assert pixels(image).any()


@pytest.mark.heavy
def test_images_of_both_are_alike_soon_after_the_younger_ones_start(noisy: Iterator[np.ndarray]) -> None:
    stage = Stage()
    for instance in ("first", "second"):
        stage.start(instance)
        for _ in range(ALIKE_CYCLES):
            made = stage.publish(next(noisy), EVERYBODY)
    assert np.abs(pixels(made["first"][0]) - pixels(made["second"][0])).max() < ALIKE_N


@pytest.mark.heavy
def test_what_ends_while_nobody_publishes_is_told_by_who_takes_over(golf: Scene) -> None:
    stage = Stage()
    for instance in ("first", "second"):
        stage.start(instance)
    for _ in range(10):
        stage.publish(golf.true[30], "first")
    for _ in range(10):
        assert not stage.publish(NOTHING, "nobody")
    _, contacts = stage.publish(NOTHING, "second")["second"]
    assert [each.identity for each in contacts.ended] == [1]
    assert not contacts.contacts
