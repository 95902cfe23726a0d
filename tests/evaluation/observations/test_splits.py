"""Splits by perturbation: nothing of a test perturbation is met before."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from evaluation.observations.signals import LABELS, OBJECTS
from evaluation.observations.splits import draw_split
from touch.classification_poses import PERTURBATIONS


@given(st.integers(0, 50), st.sampled_from([(0.4, 0.2), (0.02, 0.01), (0.0066, 0.0033)]))
def test_parts_share_no_perturbation_and_hold_all_objects(number: int, shares: tuple[float, float]) -> None:
    split = draw_split(number, *shares)
    parts = [set(part % PERTURBATIONS) for part in split]
    assert sum(map(len, parts)) == PERTURBATIONS
    assert set().union(*parts) == set(range(PERTURBATIONS))
    for part in split:
        np.testing.assert_array_equal(np.unique(LABELS[part]), np.arange(OBJECTS))


def test_sizes_are_those_of_the_paper() -> None:
    split = draw_split(0, 0.4, 0.2)
    assert [part.size for part in split] == [2304, 1152, 2304]
    assert [part.size // OBJECTS for part in draw_split(0, 0.0066, 0.0033)] == [2, 1, 357]
    assert split.training.size == 3456


def test_numbers_and_seeds_give_other_splits() -> None:
    drawn = [draw_split(*numbers).test for numbers in ((0, 0.4, 0.2), (1, 0.4, 0.2), (0, 0.4, 0.2, 1))]
    assert not np.array_equal(drawn[0], drawn[1])
    assert not np.array_equal(drawn[0], drawn[2])
    np.testing.assert_array_equal(drawn[0], draw_split(0, 0.4, 0.2).test)
