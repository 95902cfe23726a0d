"""What a stepped node makes of its samples: the noise it learns, and the filter."""

import numpy as np
import pytest
from scipy.stats import norm

from dbc.patch_filter import HORIZON, unclip_table
from nodes.steps.filtering import ForceFilter, PatchFilter
from nodes.steps.noise import IdleStatistics, Noise, unclip
from skin.walsh import haar_matrix, walsh_matrix

NODES, TAXELS, NOISE_N = 8, 32, 1e-3
SHAPE = (NODES, TAXELS)


def known(noise_n: float = NOISE_N) -> Noise:
    even = np.full(SHAPE, noise_n, np.float32)
    return Noise(np.zeros(SHAPE, np.float32), even, even)


def noisy(force_n: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.maximum(force_n + rng.normal(0, NOISE_N, SHAPE), 0).astype(np.float32)


@pytest.mark.parametrize("taxels", [1, 4, 16, 32])
def test_the_haar_pyramid_is_orthonormal(taxels: int) -> None:
    matrix = haar_matrix(taxels)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(taxels), atol=1e-6)


def test_a_node_learns_its_noise_from_clipped_samples() -> None:
    rng, statistics = np.random.default_rng(0), IdleStatistics(*SHAPE)
    true_n = rng.uniform(0.5e-3, 2e-3, SHAPE)
    for _ in range(2000):
        statistics.take(np.maximum(rng.normal(0, true_n), 0).astype(np.float32))
    learned = statistics.noise()
    np.testing.assert_allclose(learned.taxel_n, true_n, rtol=0.1)
    np.testing.assert_allclose(learned.node_n, np.sqrt(np.mean(true_n**2, axis=1)), rtol=0.1)
    np.testing.assert_allclose(learned.offset_n, 0, atol=0.2 * NOISE_N)


def test_what_idle_taxels_read_besides_noise_is_an_offset() -> None:
    rng, statistics = np.random.default_rng(1), IdleStatistics(*SHAPE)
    for _ in range(500):
        sample_n = noisy(np.zeros(SHAPE), rng)
        sample_n[2, 5] = 0.013
        statistics.take(sample_n)
    learned = statistics.noise()
    assert learned.offset_n[2, 5] == pytest.approx(0.013)
    assert np.count_nonzero(abs(learned.offset_n) > 0.4 * NOISE_N) == 1


def test_coloured_noise_counts_as_more_than_independent_noise() -> None:
    rng, statistics, value = np.random.default_rng(2), IdleStatistics(*SHAPE), np.zeros(SHAPE)
    for _ in range(2000):
        value = 0.9 * value + rng.normal(0, NOISE_N * (1 - 0.9**2) ** 0.5, SHAPE)
        statistics.take(np.maximum(value, 0).astype(np.float32))
    learned = statistics.noise()
    np.testing.assert_allclose(learned.taxel_n, NOISE_N, rtol=0.25)
    assert (learned.node_n > 2 * NOISE_N).all()


def test_a_constant_goes_through() -> None:
    force_n = np.random.default_rng(3).uniform(0.008, 0.012, SHAPE).astype(np.float32)
    node_filter = PatchFilter(known())
    for _ in range(800):
        node_filter.take(force_n)
    np.testing.assert_allclose(node_filter.force_n, force_n, atol=0.05 * NOISE_N)
    np.testing.assert_allclose(node_filter.sums_n, node_filter.force_n @ walsh_matrix(TAXELS).T, atol=1e-6)


def test_noise_falls_and_an_idle_patch_shows_nothing() -> None:
    rng, node_filter = np.random.default_rng(4), PatchFilter(known())
    force_n = np.zeros(SHAPE)
    force_n[: NODES // 2] = 0.01
    left = []
    for tick in range(1500):
        node_filter.take(noisy(force_n, rng))
        if tick >= 500:
            left.append(node_filter.force_n - force_n)
    errors = np.array(left)
    assert np.sqrt(np.mean(errors[:, : NODES // 2] ** 2)) < 0.15 * NOISE_N
    assert np.mean(errors[:, NODES // 2 :] != 0) < 1e-3
    # What a node says of its certainty is what an observer finds.
    found = np.mean((errors[:, : NODES // 2] @ walsh_matrix(TAXELS).T) ** 2)
    assert 0.3 < np.mean(node_filter.variance_n2[: NODES // 2]) / found < 3


def test_a_ramp_does_not_lag() -> None:
    rng, node_filter = np.random.default_rng(5), ForceFilter(known())
    n_per_tick, errors = 4e-5, []
    for tick in range(300):
        node_filter.take(noisy(np.full(SHAPE, 2e-3 + n_per_tick * tick), rng))
        if tick >= 100:
            errors.append(np.mean(node_filter.force_n) - (2e-3 + n_per_tick * (tick + HORIZON)))
    # A mean of 16 ms would lag by 8 ms and the horizon: 0.48 mN.
    assert abs(np.mean(errors)) < 0.2 * n_per_tick * HORIZON


def test_taxels_on_their_own_are_patches_of_one() -> None:
    noise = Noise(*(np.full((4, 1), value, np.float32) for value in (0, NOISE_N, NOISE_N)))
    taxel_filter = ForceFilter(noise)
    for _ in range(300):
        taxel_filter.take(np.array([[0.01], [0.0], [0.005], [0.02]], np.float32))
    np.testing.assert_allclose(taxel_filter.force_n[:, 0], [0.01, 0, 0.005, 0.02], atol=1e-5)


def test_the_bias_of_clipping_is_undone() -> None:
    force = np.linspace(-1.0, 5.9, 60)
    noise_n = np.linspace(0.5e-3, 2e-3, 60).astype(np.float32)
    # The mean of N(x, 1) that is clipped at 0.
    shown_n = ((force * norm.cdf(force) + norm.pdf(force)) * noise_n).astype(np.float32)
    unclip(shown_n, noise_n, unclip_table())
    np.testing.assert_allclose(shown_n / noise_n, force, atol=0.01)
    ends_n = np.array([-1.0, 0.0, 6.5, 9.0], np.float32)
    unclip(ends_n, np.ones(4, np.float32), unclip_table())
    np.testing.assert_allclose(ends_n, [-2, -2, 6.5, 9], atol=1e-6)
