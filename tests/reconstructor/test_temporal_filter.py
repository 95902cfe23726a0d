"""The temporal filter: it averages what rests, follows what moves, and forgets what stays away."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstructor.temporal_filter import FLOOR, FilterState, TemporalFilter, update

ALL = np.ones(1024, np.bool_)


def noise(seed: int, count: int, level_n: float = 0.003) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, level_n, (count, 1024))


def feed(filtered: TemporalFilter, sums: np.ndarray) -> list[float]:
    gains = []
    for each in sums:
        assert filtered.take(each, ALL)
        gains.append(filtered.gain)
    return gains


@pytest.mark.parametrize("level_n", [1e-4, 3e-3, 1.0])
def test_resting_sums_are_averaged_whatever_the_noise(level_n: float) -> None:
    filtered = TemporalFilter(1024, np.float64)
    gains = feed(filtered, 0.05 + noise(0, 100, level_n))
    assert gains[0] == 1
    assert max(gains[50:]) < 0.3
    assert np.std(filtered.sums - 0.05) < 0.4 * level_n
    assert filtered.noise_n == pytest.approx(level_n, rel=0.15)
    assert filtered.noise_ratio == pytest.approx(np.std(filtered.sums - 0.05) / level_n, rel=0.2)


def test_gain_rises_with_the_speed_and_the_lag_stays_below_the_noise() -> None:
    drift = np.random.default_rng(1).normal(0, 1, 1024)
    means = []
    for speed_n in (0.0, 0.0003, 0.001, 0.003):
        filtered = TemporalFilter(1024, np.float64)
        steps = np.arange(300)[:, None]
        gains = feed(filtered, steps * speed_n * drift + noise(2, 300))
        means.append(np.mean(gains[100:]))
        lag = filtered.sums - 299 * speed_n * drift
        assert np.std(lag) < 0.0036  # 0.003 is what the last sums alone would give
    assert means == sorted(means)
    assert means[0] < 0.3
    assert means[-1] > 0.7


def test_surprise_is_the_size_of_a_change_in_standard_deviations_of_the_noise() -> None:
    filtered = TemporalFilter(1024, np.float64)
    feed(filtered, noise(3, 100))
    assert filtered.surprise == pytest.approx(1, rel=0.1)
    feed(filtered, noise(4, 1, 0.03))
    assert filtered.surprise == pytest.approx(10, rel=0.15)


def test_sudden_change_is_taken_over_at_once() -> None:
    filtered = TemporalFilter(1024, np.float64)
    feed(filtered, noise(3, 50))
    step = np.random.default_rng(4).normal(0, 0.03, 1024)
    gains = feed(filtered, step + noise(5, 40))
    assert gains[0] > 0.99
    assert max(gains[20:]) < 0.5
    np.testing.assert_allclose(filtered.sums, step, atol=0.01)


@pytest.mark.parametrize(("speed_n", "cycles"), [(0.0, 30), (0.01, 3)])
def test_silent_sums_fade_as_fast_as_the_touch_moves(speed_n: float, cycles: int) -> None:
    filtered = TemporalFilter(1024, np.float64)
    drift = np.random.default_rng(1).normal(0, 1, 1024)
    sums = np.arange(90)[:, None] * speed_n * drift + noise(6, 90)
    feed(filtered, sums[:50])
    valid = np.arange(1024) % 8 > 0
    weights = []
    for each in sums[50:]:
        filtered.take(np.where(valid, each, np.nan), valid)
        weights.append(filtered.weights[~valid].max())
    assert np.isfinite(filtered.sums).all()
    assert weights == sorted(weights, reverse=True)
    assert weights[0] > 0 or speed_n > 0
    assert weights[cycles] == 0
    assert (filtered.weights[valid] == 1).all()
    filtered.take(sums[0] + 1, ALL)  # back again: nothing of the past is left in it
    np.testing.assert_allclose(filtered.sums[~valid], (sums[0] + 1)[~valid])


@given(st.integers(0, 1023), st.sampled_from([np.nan, np.inf, -np.inf]))
@settings(max_examples=20, deadline=None)
def test_sums_that_are_not_finite_change_nothing(where: int, value: float) -> None:
    filtered = TemporalFilter(1024, np.float32)
    feed(filtered, noise(7, 5).astype(np.float32))
    before = filtered.sums.copy(), filtered.weights.copy(), filtered.gain
    bad = noise(8, 1)[0].astype(np.float32)
    bad[where] = value
    assert not filtered.take(bad, ALL)
    np.testing.assert_array_equal(filtered.sums, before[0])
    np.testing.assert_array_equal(filtered.weights, before[1])
    assert filtered.gain == before[2]


def test_reset_forgets_the_sums_and_restart_the_noise_too() -> None:
    filtered, fresh = TemporalFilter(1024, np.float64), TemporalFilter(1024, np.float64)
    feed(filtered, noise(9, 30))
    filtered.reset()
    assert not filtered.sums.any()
    assert not filtered.weights.any()
    assert filtered.gain == 1
    assert filtered.noise_n == pytest.approx(0.003, rel=0.15)
    filtered.restart()
    assert filtered.noise_n == 0
    assert feed(filtered, noise(10, 30)) == feed(fresh, noise(10, 30))


def test_noise_floor_follows_a_sensor_that_gets_noisier() -> None:
    filtered = TemporalFilter(1024, np.float64)
    feed(filtered, noise(11, 60, 0.001))
    assert filtered.noise_n == pytest.approx(0.001, rel=0.15)
    levels = []
    for each in noise(12, 1000, 0.002):
        filtered.take(each, ALL)
        levels.append(filtered.noise_n)
    assert levels[100] < 0.0015  # slowly: a touch that moves is no noise
    assert levels[-1] == pytest.approx(0.002, rel=0.15)


@pytest.mark.parametrize(("silent_cycles", "rest"), [(1, 0.2), (60, 0.0)])
def test_sum_that_comes_back_counts_by_how_long_it_was_missed(silent_cycles: int, rest: float) -> None:
    filtered = TemporalFilter(1024, np.float64)
    feed(filtered, noise(13, 60))
    valid = np.arange(1024) % 8 > 0
    for each in noise(14, silent_cycles):
        filtered.take(each, valid)
    before, weights = filtered.sums[~valid].copy(), filtered.weights[~valid].copy()
    (back,) = noise(15, 1)
    filtered.take(back, ALL)
    assert filtered.gain < 0.4
    share = np.maximum(filtered.gain, 1 - weights)
    np.testing.assert_allclose(filtered.sums[~valid], before + share * (back[~valid] - before))
    assert (share == 1).all() == (rest == 0)


def test_averaged_sums_are_taken_as_they_come_and_missing_ones_kept_while_nothing_moves() -> None:
    filtered = TemporalFilter(1024, np.float64, averages=False)
    sums = 0.05 + noise(5, 60, 5e-5)
    for each in sums:
        filtered.take(each, ALL)
        np.testing.assert_array_equal(filtered.sums, each)
    assert filtered.gain == 1
    assert filtered.noise_n == pytest.approx(5e-5, rel=0.15)
    missing = ALL.copy()
    missing[:8] = False
    filtered.take(sums[-2], missing)
    assert (filtered.weights[:8] > 0.5).all()
    filtered.take(sums[-1] + noise(6, 1)[0], missing)  # a touch moves
    assert not filtered.weights[:8].any()
    assert filtered.surprise > 10


def test_only_a_sum_measured_twice_in_a_row_has_an_innovation() -> None:
    names = ["known", "new", "missing"]
    sums, innovation = np.array([1.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.3])
    state = FilterState(sums, np.array([1.0, 0.0, 1.0]), innovation, np.array([0.2, 1e-6, 0.2, 1.0]))
    assert update(state, np.array([1.5, 2.0, np.nan]), np.array([True, True, False]), True)
    assert dict(zip(names, innovation.tolist(), strict=True)) == {"known": 0.5, "new": 0.0, "missing": 0.0}
    assert state.weights.tolist()[:2] == [1, 1]
    assert sums[1] == 2.0  # nothing of the past stands for a sum that was not known
    assert state.state[FLOOR] > 0
