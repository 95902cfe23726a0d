"""What a running node goes on learning: drifting offsets and the size of its noise."""

from dataclasses import replace

import numpy as np
import pytest

from nodes.adaptive.filtering import ForceFilter, PatchFilter
from nodes.adaptive.following import BELIEF, WINDOW, NoiseScale
from nodes.adaptive.noise import Noise

NODES, TAXELS, NOISE_N = 4, 32, 1e-3
SHAPE = (NODES, TAXELS)
EVEN = np.full(SHAPE, NOISE_N, np.float32)
KNOWN = Noise(np.zeros(SHAPE, np.float32), EVEN, EVEN)


def noisy(force_n: np.ndarray | float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(force_n + rng.normal(0, NOISE_N, SHAPE), 0, 0.02).astype(np.float32)


def after(samples: int, force_n: np.ndarray | float, node_filter: ForceFilter, rng: np.random.Generator) -> np.ndarray:
    """Return the mean force that a filter shows over the last tenth of so many samples."""
    shown = []
    for tick in range(samples):
        node_filter.take(noisy(force_n, rng))
        if tick >= 0.9 * samples:
            shown.append(node_filter.force_n.copy())
    return np.mean(shown, axis=0)


@pytest.mark.parametrize("n_per_s", [-1e-3, 1e-3])
def test_a_drift_of_an_untouched_taxel_is_followed(n_per_s: float) -> None:
    rng, node_filter = np.random.default_rng(0), PatchFilter(KNOWN)
    drift_n = 0.0
    for _ in range(1400):
        drift_n += 1e-3 * n_per_s
        node_filter.take(noisy(drift_n, rng))
    assert np.mean(node_filter.force_n) < 0.05 * NOISE_N
    # A touch now is shown without the offset, as far as readings of 0 let the node see how far it fell.
    shown = after(100, 0.008 + drift_n, node_filter, rng)
    assert np.mean(shown) == pytest.approx(0.008, abs=0.7e-3)


def test_a_force_that_stays_is_no_offset() -> None:
    rng, node_filter = np.random.default_rng(1), PatchFilter(KNOWN)
    force_n = np.zeros(SHAPE)
    force_n[0, :16] = 0.003
    after(300, 0.0, node_filter, rng)
    shown = after(4000, force_n, node_filter, rng)
    np.testing.assert_allclose(shown[0, :16], 0.003, atol=0.25e-3)


def test_what_was_followed_while_a_touch_began_is_given_back() -> None:
    rng, node_filter = np.random.default_rng(2), PatchFilter(KNOWN)
    after(500, 0.0, node_filter, rng)
    # 10 mN/s, as the paper's objects.
    for tick in range(500):
        node_filter.take(noisy(1e-5 * tick, rng))
    assert np.mean(after(300, 0.005, node_filter, rng)) == pytest.approx(0.005, abs=0.15e-3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_size_of_the_noise_is_found_while_nothing_touches(factor: float) -> None:
    rng = np.random.default_rng(3)
    wrong = replace(KNOWN, taxel_n=EVEN * np.float32(factor), coefficient_n=EVEN * np.float32(factor))
    node_filter = PatchFilter(wrong)
    after(5000, 0.0, node_filter, rng)
    np.testing.assert_allclose(node_filter.noise.taxel_n, NOISE_N, rtol=0.07)
    np.testing.assert_allclose(node_filter.noise.node_n, NOISE_N, rtol=0.07)


def test_nothing_is_learned_from_touched_taxels() -> None:
    rng, scale = np.random.default_rng(4), NoiseScale(*SHAPE)
    force_n = np.zeros(SHAPE)
    force_n[0] = 0.004
    found = [scale.take(noisy(force_n, rng), 2 * EVEN) for _ in range(WINDOW)]
    assert found[:-1] == [None] * (WINDOW - 1)
    assert found[-1] is not None
    assert found[-1][0] == 1
    np.testing.assert_allclose(found[-1][1:], 0.5**BELIEF, rtol=0.03)


def test_taxels_without_noise_say_nothing_of_it() -> None:
    scale, quiet = NoiseScale(*SHAPE), np.zeros(SHAPE, np.float32)
    found = [scale.take(quiet, EVEN) for _ in range(WINDOW)][-1]
    assert found is not None
    assert (found == 1).all()


def test_a_touch_that_comes_and_goes_is_no_noise() -> None:
    rng, scale = np.random.default_rng(5), NoiseScale(*SHAPE)
    found = [scale.take(noisy(0.006 if tick % 150 < 50 else 0.0, rng), EVEN) for tick in range(WINDOW)][-1]
    assert found is not None
    assert (found == 1).all()
