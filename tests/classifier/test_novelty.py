"""What known touches look like, and what lies beyond."""

import numpy as np
import pytest

from classifier.known_regions import LEAST_PER_REGION, fit_regions
from classifier.novelty import Regions, nearest, novelty


def clouds(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    names = np.array(["left", "right"])[np.arange(count) % 2]
    middle = np.where(names == "left", -5.0, 5.0)
    return rng.normal(size=(count, 3)) * [1.0, 0.2, 0.2] + middle[:, None] * [1, 0, 0], names


def test_distance_is_that_of_mahalanobis() -> None:
    centres = np.array([[0.0, 0.0], [10.0, 0.0]])
    whitening = np.array([np.diag([1.0, 2.0]), np.eye(2)])
    assert nearest(np.array([0.0, 3.0]), centres, whitening) == (0, 6.0)
    assert nearest(np.array([10.0, 3.0]), centres, whitening) == (1, 3.0)
    regions = Regions(centres, whitening, np.array([3.0, 1.0]))
    assert novelty(np.array([0.0, 3.0]), regions) == 2.0
    assert novelty(np.array([10.0, 3.0]), regions) == 3.0  # by the limit of the nearest region


def test_every_feature_counts_in_the_distance() -> None:
    centres, whitening = np.array([[9.0, 9.0, 9.0], [0.0, 0.0, 0.0]]), np.array([np.eye(3)] * 2)
    assert nearest(np.array([2.0, 2.0, 1.0]), centres, whitening) == (1, 3.0)


@pytest.mark.heavy
def test_known_is_near_and_new_is_far() -> None:
    regions = fit_regions(*clouds(300, 0), clouds(200, 1)[0], seed=0)
    known = [novelty(one, regions) for one in clouds(1000, 2)[0]]
    assert np.mean(np.array(known) > 1) < 0.05
    assert novelty(np.array([0.0, 0.0, 0.0]), regions) > 1
    assert novelty(np.array([-5.0, 3.0, 0.0]), regions) > 2


@pytest.mark.heavy
def test_whitening_undoes_the_covariance() -> None:
    features, names = clouds(300, 0)
    regions = fit_regions(features, names, features, seed=0)
    counts = [int((names == name).sum()) // LEAST_PER_REGION for name in ("left", "right")]
    assert len(regions.limits) <= sum(counts)
    assert regions.whitening.shape == (len(regions.limits), 3, 3)
    assert (regions.limits > 0).all()


@pytest.mark.parametrize("count", [2 * LEAST_PER_REGION - 2, 20])
def test_too_little_is_known_to_call_anything_new(count: int) -> None:
    regions = fit_regions(*clouds(count, 0), clouds(50, 1)[0], seed=0)
    assert regions.limits.size == 0
    assert novelty(np.full(3, 1e6), regions) == 0
