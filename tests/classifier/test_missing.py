"""Sums that did not come are estimated from those that did."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from classifier.missing import Completion, Factors, fit_factors


def drawn(count: int = 400, sums: int = 12, factors: int = 2, noise: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(0)
    return (
        rng.normal(size=(count, factors)) @ rng.normal(size=(factors, sums))
        + 3
        + noise * rng.normal(size=(count, sums))
    )


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_expectation_is_that_of_the_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = Factors(rng.normal(size=9), rng.normal(size=(9, 3)), 0.2)
    valid = rng.random(9) < 0.6
    sums = rng.normal(size=9)
    covariance = model.loadings @ model.loadings.T + 0.2 * np.eye(9)
    expected = sums.copy()
    across = covariance[np.ix_(~valid, valid)]
    expected[~valid] = model.mean[~valid] + across @ np.linalg.solve(
        covariance[np.ix_(valid, valid)], (sums - model.mean)[valid]
    )
    Completion(model).complete(sums, valid)
    np.testing.assert_allclose(sums, expected, rtol=1e-8, atol=1e-10)


def test_sums_that_vary_together_are_filled_in() -> None:
    model = fit_factors(drawn())
    one = drawn()[7].copy()
    sums, valid = one.copy(), np.ones(12, np.bool_)
    valid[[2, 9]] = False
    sums[~valid] = 1e6
    Completion(model).complete(sums, valid)
    np.testing.assert_array_equal(sums[valid], one[valid])
    np.testing.assert_allclose(sums[~valid], one[~valid], atol=0.1)


def test_equal_observations_leave_a_usable_model() -> None:
    model = fit_factors(np.full((5, 4), 2.0))
    assert model.noise > 0
    sums = np.zeros(4)
    Completion(model).complete(sums, np.array([True, True, False, False]))
    assert np.isfinite(sums).all()
