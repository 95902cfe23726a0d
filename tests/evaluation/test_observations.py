"""What is measured of every observation, and splits by perturbation: nothing of a test perturbation is met before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.observations import LABELS, OBJECTS, all_rows, draw_split, phi_of, sensed, signal
from touch.classification_poses import PERTURBATIONS
from touch.coarse_arrays import averaged


@pytest.mark.heavy
def test_sums_are_those_of_what_the_taxels_felt() -> None:
    felt = sensed(None, 0)
    assert felt.shape == (5760, 4096)
    assert felt.min() == 0
    assert 0.009 <= felt.max() <= np.float32(0.02)  # pressed in by 9.99 mm at 1 N/m, the range ends at 20 mN
    for kind in ("sbhe", "noiselet"):
        values = signal(kind, 16, 3, None, 0)
        np.testing.assert_allclose(values[:5], phi_of(kind, 16, 3).forward(felt[:5]), atol=1e-5)
    assert LABELS.shape == (5760,)


def test_candidate_rows_lie_in_the_same_scrambled_blocks() -> None:
    every = all_rows(2)
    np.testing.assert_array_equal(every.order, phi_of("sbhe", 64, 2).order)
    assert every.kept.all()


@pytest.mark.heavy
def test_coarse_taxels_are_means_with_their_own_noise() -> None:
    coarse = signal("averaged", 64, 0, None, 0)
    assert coarse.shape == (5760, 64)
    fine = averaged(sensed(None, 0).reshape(-1, 64, 64)[:50], 8).reshape(50, 64)
    # The fine noise averages out to the mean of what clipping leaves of it, 0.4 mN; the coarse one stays.
    assert np.std(coarse[:50] - fine) == pytest.approx(0.6e-3, rel=0.3)


@pytest.mark.heavy
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
