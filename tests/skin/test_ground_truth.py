"""Without a single instant a truth belongs to the image on show; a stepped label belongs to the nearest truth."""

import random
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canskin.messages import Image, Label, Truth
from skin.ground_truth import (
    IMAGES_KEPT,
    SHOWN_NS,
    TRUTHS_KEPT,
    NearestTruths,
    Pairing,
    ShownImages,
    image_pairs,
    label_pairs,
)
from skin.layout import load_layout
from skin.sync_counter import SYNC_OVERFLOW
from tests import messages as make
from tests.layouts import in_one_instant

MS = 1_000_000


def image(published_ms: float) -> Image:
    return make.image(sampled_mono_ns=round((published_ms - 3) * MS), published_mono_ns=round(published_ms * MS))


def truth(time_ms: float) -> Truth:
    return make.truth(sync_counter=0, sampled_mono_ns=round(time_ms * MS))


def label(time_ms: float) -> Label:
    return make.label(sampled_mono_ns=round(time_ms * MS))


def times_ms(found: list[tuple[Image, Truth]]) -> list[tuple[float, float]]:
    return [(shown.published_mono_ns / MS, true.sampled_mono_ns / MS) for shown, true in found]


def test_each_way_of_sending_has_its_pairs() -> None:
    assert isinstance(image_pairs(in_one_instant()), Pairing)
    assert isinstance(image_pairs(load_layout()), ShownImages)
    for layout in (in_one_instant(), load_layout()):
        assert isinstance(label_pairs(layout), Pairing)
    stepped = load_layout(Path("steps"))
    assert isinstance(image_pairs(stepped), ShownImages)
    assert isinstance(label_pairs(stepped), NearestTruths)


def test_a_truth_waits_until_the_image_on_show_is_known() -> None:
    pairs = ShownImages()
    assert pairs.take(image(8)) == []
    assert pairs.take_truth(truth(10)) == []  # an image published at 9 may be on its way
    assert times_ms(pairs.take(image(11))) == [(8, 10)]
    assert times_ms(pairs.take_truth(truth(10.5))) == [(8, 10.5)]
    assert pairs.take_truth(truth(20)) == []
    assert pairs.take(image(20)) == []
    assert times_ms(pairs.take(image(20.1))) == [(20, 20)]


def test_a_quiet_skin_shows_one_image_at_many_truths() -> None:
    pairs = ShownImages()
    pairs.take(image(1))
    for each in range(10, 100, 10):
        assert pairs.take_truth(truth(each)) == []
    assert times_ms(pairs.take(image(101))) == [(1, each) for each in range(10, 100, 10)]


@pytest.mark.parametrize("seed", range(20))
def test_messages_of_two_services_come_in_any_order_of_each_other(seed: int) -> None:
    draw, pairs, found = random.Random(seed), ShownImages(), []
    images = [image(each + 0.5) for each in range(200)]
    truths = [truth(10 * each) for each in range(1, 20)]
    while images or truths:
        if images and (not truths or draw.random() < 0.9):
            found += pairs.take(images.pop(0))
        else:
            found += pairs.take_truth(truths.pop(0))
    assert times_ms(found) == [(10 * each - 0.5, 10 * each) for each in range(1, 20)]


def test_an_image_of_a_reconstructor_that_stopped_is_not_on_show() -> None:
    pairs = ShownImages()
    pairs.take(image(0))
    late_ms = SHOWN_NS / MS + 10
    pairs.take_truth(truth(late_ms))
    assert pairs.take(image(late_ms + 1)) == []
    assert pairs.take_truth(truth(late_ms - 1000)) == []  # no image of that time is left


def test_nothing_piles_up_without_the_other_topic() -> None:
    pairs = ShownImages()
    for each in range(200):
        pairs.take_truth(truth(1000 + each))
    assert len(pairs.take(image(999)) + pairs.take(image(2000))) == TRUTHS_KEPT
    for each in range(2000):
        pairs.take(image(2000 + each))
    forgotten_ms = 4000 - IMAGES_KEPT - 1
    assert pairs.take_truth(truth(forgotten_ms + 0.5)) == []
    assert len(pairs.take_truth(truth(forgotten_ms + 1.5))) == 1


def test_the_truth_beside_an_image_is_the_nearest() -> None:
    pairs = ShownImages()
    assert pairs.truth_of(image(10)) is None
    for each in (10, 20, 30):
        pairs.take_truth(truth(each))
    near = pairs.truth_of(image(24))
    assert near is not None
    assert near.sampled_mono_ns == 20 * MS
    assert pairs.truth_of(image(51)) is None


def test_a_label_is_judged_by_the_truth_nearest_to_its_sums() -> None:
    pairs = NearestTruths()
    pairs.take_truth(truth(10))
    assert pairs.take(label(17)) == []  # the truth at 20 is nearer
    assert pairs.take(label(19)) == []
    assert [true.sampled_mono_ns for _, true in pairs.take_truth(truth(20))] == [20 * MS] * 2
    assert [true.sampled_mono_ns for _, true in pairs.take(label(12))] == [10 * MS]
    assert pairs.take_truth(truth(100)) == []
    assert pairs.take(label(60)) == []  # no truth near
    assert len(pairs.take(label(100))) == 1


@pytest.mark.parametrize("rate_hz", [40, 100, 250, 500, 1000])
def test_each_message_has_the_truth_of_its_own_cycle_though_the_counter_repeats(rate_hz: int) -> None:
    """The counter runs from 1 to 240. Labels come before their truths, and after; some truths never come."""
    pairs: Pairing[Label] = Pairing(1 / rate_hz)
    found: list[tuple[Label, Truth]] = []
    for cycle in range(2000):
        counter, time_ns = cycle % 240 + 1, cycle * 1_000_000_000 // rate_hz
        said = make.label(cycle, sync_counter=counter, sampled_mono_ns=time_ns + 1000)
        true = make.truth(cycle, sync_counter=counter, sampled_mono_ns=time_ns)
        if cycle % 3:
            found += pairs.take(said)
        if cycle % 7:
            found += pairs.take_truth(true)
        if cycle % 3 == 0:
            found += pairs.take(said)
    assert [said.cycle for said, _ in found] == [true.step for _, true in found]
    assert [said.cycle for said, _ in found] == [cycle for cycle in range(2000) if cycle % 7]


@given(order=st.permutations([(kind, cycle) for kind in ("image", "truth") for cycle in range(1, 9)]))
def test_every_pair_is_handed_out_once_in_any_order(order: list[tuple[str, int]]) -> None:
    pairing: Pairing[Image] = Pairing(0.01)
    pairs: list[int] = []
    for kind, cycle in order:
        common: dict[str, Any] = {"sync_counter": cycle, "sampled_mono_ns": cycle * 10_000_000}
        if kind == "image":
            pairs += [truth.sync_counter for _, truth in pairing.take(make.image(cycle, **common))]
        else:
            truth = make.truth(cycle, **common)
            pairs += [image.cycle for image, _ in pairing.take_truth(truth)]
    assert sorted(pairs) == list(range(1, 9))


def test_pairs_of_one_cycle_are_forgotten_after_a_round_of_the_counter() -> None:
    pairs: Pairing[Image] = Pairing(0.01)
    for step in range(SYNC_OVERFLOW + 1):
        assert pairs.take(msgspec.structs.replace(image(10 * step), sync_counter=1000 + step)) == []
    first, second = (msgspec.structs.replace(truth(10 * step), sync_counter=1000 + step) for step in (0, 1))
    assert pairs.take_truth(first) == []
    assert len(pairs.take_truth(second)) == 1
