"""The decision graph: every walk leaves one class, and asks M - 1 pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from classifier.dag import pairs, walked
from classifier.descent import descend


def decided(*margins: float, classes: int) -> tuple[int, float]:
    """Return class and confidence of the compiled walk: margins are hyperplanes without normals."""
    return descend(np.zeros(0), np.zeros((len(margins), 0)), np.array(margins), classes)


@given(st.integers(2, 9), st.integers(0, 2**32 - 1), st.data())
def test_class_that_wins_all_its_pairs_is_chosen(classes: int, seed: int, data: st.DataObject) -> None:
    best = data.draw(st.integers(0, classes - 1))
    margins = np.random.default_rng(seed).normal(size=len(pairs(classes)))
    for index, (first, second) in enumerate(pairs(classes)):
        if best in {first, second}:
            margins[index] = 1.0 if best == first else -1.0
    assert walked(margins[None], classes)[0] == [best]


def test_order_matters_only_in_a_cycle() -> None:
    # 0 beats 1, 1 beats 2, 2 beats 0: the graph asks (0, 2) first and then (1, 2).
    winners, paths = walked(np.array([[1.0, -2.0, 3.0]]), 3)
    assert (winners.tolist(), paths.tolist()) == ([1], [[2.0, 3.0]])


def test_confidence_is_the_product_along_the_path() -> None:
    _, confidence = decided(2.0, 1.0, -7.0, classes=3)  # asks (0, 2), then (0, 1)
    assert confidence == pytest.approx(1 / (1 + np.exp(-1.0)) / (1 + np.exp(-2.0)))
    assert decided(1000.0, classes=2) == (0, 1.0)


@given(st.integers(2, 9), st.lists(st.sampled_from([-1.0, 0.0, 1.0]), min_size=36, max_size=36))
def test_many_decisions_at_once_are_those_of_each_ties_included(classes: int, drawn: list[float]) -> None:
    margins = np.array(drawn)[: len(pairs(classes))]
    winners, paths = walked(np.stack([margins, -margins]), classes)
    for each, winner, path in zip((margins, -margins), winners, paths, strict=True):
        assert decided(*each, classes=classes) == (winner, pytest.approx(np.prod(1 / (1 + np.exp(-path)))))


def test_tie_goes_to_the_first_class_and_is_a_coin_toss() -> None:
    assert decided(0.0, classes=2) == (0, 0.5)
