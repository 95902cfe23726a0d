"""What a running node goes on learning: drifting offsets and the size of its noise."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from dbc.patch_filter import WINDOW
from nodes.steps.filtering import ForceFilter, PatchFilter
from nodes.steps.following import ScaleSums, follow, gather, judged, new_offsets
from nodes.steps.noise import Noise

NODES, TAXELS, NOISE_N = 4, 32, 1e-3
SHAPE = (NODES, TAXELS)
EVEN = np.full(SHAPE, NOISE_N, np.float32)
KNOWN = Noise(np.zeros(SHAPE, np.float32), EVEN, EVEN)


def noisy(force_n: np.ndarray | float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(force_n + rng.normal(0, NOISE_N, SHAPE), 0, 0.02).astype(np.float32)


def after(samples: int, force_n: np.ndarray | float, node_filter: ForceFilter, rng: np.random.Generator) -> np.ndarray:
    """Return the mean force that a filter shows over the last tenth of `samples`."""
    shown = []
    for tick in range(samples):
        node_filter.take(noisy(force_n, rng))
        if tick >= 0.9 * samples:
            shown.append(node_filter.force_n.copy())
    return np.mean(shown, axis=0)


def ramp(samples: int, n_per_s: float, node_filter: ForceFilter, rng: np.random.Generator, from_n: float) -> None:
    for tick in range(samples):
        node_filter.take(noisy(from_n + 1e-3 * n_per_s * tick, rng))


def test_a_zero_that_falls_is_followed_at_once() -> None:
    rng, node_filter = np.random.default_rng(0), PatchFilter(KNOWN)
    ramp(1400, -1e-3, node_filter, rng, 0.0)
    # A touch now is shown without the offset, as far as readings of 0 let the node see how far it fell.
    assert np.mean(after(100, 0.0066, node_filter, rng)) == pytest.approx(0.008, abs=0.7e-3)


def test_a_zero_above_the_range_is_found_wherever_it_falls_and_comes_back_without_a_touch() -> None:
    """The taxels read 6 mN at power-up: their noise is not clipped."""
    rng, node_filter = (
        np.random.default_rng(10),
        PatchFilter(replace(KNOWN, offset_n=np.full(SHAPE, 0.006, np.float32))),
    )
    assert np.mean(after(500, 0.006, node_filter, rng)) < 0.05 * NOISE_N
    after(5000, 0.002, node_filter, rng)
    assert np.mean(after(500, 0.007, node_filter, rng)) == pytest.approx(0.005, abs=0.1e-3)
    ramp(10_000, 0.4e-3, node_filter, rng, 0.002)
    assert np.mean(after(500, 0.006, node_filter, rng)) < 0.05 * NOISE_N
    assert np.mean(after(500, 0.011, node_filter, rng)) == pytest.approx(0.005, abs=0.2e-3)


@pytest.mark.parametrize("n_per_s", [0.2e-3, 1e-3, 3e-3])
def test_a_slow_touch_is_no_drift(n_per_s: float) -> None:
    rng, node_filter = np.random.default_rng(0), PatchFilter(KNOWN)
    ramp(round(4 / n_per_s), n_per_s, node_filter, rng, 0.0)
    assert np.mean(after(300, 0.004, node_filter, rng)) == pytest.approx(0.004, abs=0.15e-3)


def test_an_offset_rises_slowly_and_not_far() -> None:
    still, offsets = np.full((1, 32), NOISE_N, np.float32), new_offsets(np.zeros((1, 32), np.float32))
    for tick in range(60_000):
        force_n = np.full((1, 4, 8), 0.5e-3 + max(0, min(0.7e-3, 15e-9 * (tick - 20_000))), np.float32)
        follow(force_n, still.reshape(1, 4, 8), offsets)
        if tick == 9_999:
            np.testing.assert_allclose(offsets.offset, 0.2e-3, rtol=0.01)
    np.testing.assert_allclose(offsets.offset, 1e-3, rtol=1e-6)


def test_a_force_that_stays_is_no_offset() -> None:
    rng, node_filter = np.random.default_rng(1), PatchFilter(KNOWN)
    force_n = np.zeros(SHAPE)
    force_n[0, :16] = 0.003
    after(300, 0.0, node_filter, rng)
    shown = after(4000, force_n, node_filter, rng)
    np.testing.assert_allclose(shown[0, :16], 0.003, atol=0.25e-3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_size_of_the_noise_is_found_while_nothing_touches(factor: float) -> None:
    rng = np.random.default_rng(3)
    wrong = replace(KNOWN, taxel_n=EVEN * np.float32(factor), coefficient_n=EVEN * np.float32(factor))
    node_filter = PatchFilter(wrong)
    after(5000, 0.0, node_filter, rng)
    np.testing.assert_allclose(node_filter.noise.taxel_n, NOISE_N, rtol=0.07)
    np.testing.assert_allclose(node_filter.noise.node_n, NOISE_N, rtol=0.07)


def new_sums(shape: tuple[int, int] = SHAPE) -> ScaleSums:
    return ScaleSums(*np.zeros((3, *shape), np.float32))


def scale_of(samples: Iterable[np.ndarray], noise_n: np.ndarray, sums: ScaleSums, taxels: int = 0) -> np.ndarray:
    """Return by what the noise of each node is larger than it is taken to be, after the samples of a window."""
    for sample_n in samples:
        gather(sample_n, sums)
    return judged(sums, noise_n, np.full(len(noise_n), taxels or noise_n.shape[1]))


def test_a_board_with_empty_places_learns_from_the_taxels_that_it_has() -> None:
    rng, held = np.random.default_rng(4), 10
    samples = [noisy(np.zeros(SHAPE), rng) * (np.arange(TAXELS) < held) for _ in range(WINDOW)]
    found = scale_of(samples, EVEN / 2, new_sums(), held)
    assert found.ravel() == pytest.approx(2**0.25, rel=0.1)
    assert (scale_of(samples, EVEN / 2, new_sums()) == 1).all()  # less than half of a board without empty places


def test_nothing_is_learned_from_touched_taxels() -> None:
    rng = np.random.default_rng(4)
    force_n = np.zeros(SHAPE)
    force_n[0] = 0.004
    found = scale_of((noisy(force_n, rng) for _ in range(WINDOW)), 2 * EVEN, new_sums())
    assert found[0] == 1
    np.testing.assert_allclose(found[1:], 0.5**0.25, rtol=0.03)


def test_a_touch_that_comes_and_goes_is_no_noise() -> None:
    rng = np.random.default_rng(5)
    samples = (noisy(0.006 if tick % 150 < 50 else 0.0, rng) for tick in range(WINDOW))
    assert (scale_of(samples, EVEN, new_sums()) == 1).all()


class SlowOffsets:
    """Offsets of one patch as docs/steps.md has them, taxel by taxel."""

    def __init__(self, idle: np.ndarray) -> None:
        self.idle, self.offset = idle, idle.copy()

    def take(self, force_n: np.ndarray, noise_n: np.ndarray) -> np.ndarray:
        shown = force_n - self.offset
        quiet = np.pad(shown < 0.6 * noise_n, 1, constant_values=True)
        for row, column in np.ndindex(shown.shape):
            if quiet[row : row + 3, column : column + 3].all():
                offset, idle = self.offset[row, column], self.idle[row, column]
                offset += np.clip(shown[row, column] / 128, -1e-6, 5e-7 if offset < idle else 2e-8)
                self.offset[row, column] = max(-1.5 * noise_n[row, column], min(idle + 1e-3, offset))
        return shown


def test_offsets_are_followed_as_documented() -> None:
    rng, high, wide = np.random.default_rng(7), 2, 4
    noise_n = rng.uniform(0.5e-3, 1.5e-3, (2, high, wide)).astype(np.float32)
    idle_n = rng.uniform(-0.5e-3, 1e-3, (2, high, wide)).astype(np.float32)
    offsets, slow = new_offsets(idle_n.reshape(2, -1)), [SlowOffsets(each.astype(np.float64)) for each in idle_n]
    drift_n = rng.uniform(-6e-6, 1e-6, (2, high, wide))
    touched, shown, expected, lowest = np.zeros((high, wide)), [], [], 0.0
    for tick in range(3000):
        if tick % 170 == 150 and tick < 700:
            touched[:] = 0
            touched[rng.integers(high), rng.integers(wide)] = 0.01
        elif tick % 170 == 0:
            touched[:] = 0
        moved_n = min(tick, 3000 - tick) * drift_n + touched + rng.normal(0, 0.05e-3, drift_n.shape)
        force_n = (idle_n + moved_n).astype(np.float32)
        given = force_n.copy()
        follow(given, noise_n, offsets)
        shown.append(given)
        expected.append([slow[node].take(force_n[node].astype(np.float64), noise_n[node]) for node in range(2)])
        lowest = min(lowest, (offsets.offset / noise_n).min())
    np.testing.assert_allclose(shown, expected, atol=1e-6)
    assert np.min(lowest) == pytest.approx(-1.5)


def test_the_size_of_noise_is_the_median_of_idle_taxels() -> None:
    """Exactly half of a patch is idle; a taxel fewer says nothing."""
    rng, sums = np.random.default_rng(8), new_sums((2, 8))
    true_n = np.full((2, 8), 1e-3)
    samples = np.maximum(rng.normal(0, true_n, (WINDOW, 2, 8)), 0).astype(np.float32)
    samples[:, 0, 4:] += np.float32(0.01)
    samples[:, 1, 3:] += np.float32(0.01)
    taken_n = np.linspace(0.5e-3, 2e-3, 16).reshape(2, 8).astype(np.float32)
    found = scale_of(samples, taken_n, sums)
    # Noise that is clipped at 0 has a standard deviation of sqrt(1/2 - 1/2π); two samples differ by twice the variance.
    square = (np.diff(samples.astype(np.float64), axis=0, prepend=0) ** 2).sum(axis=0)
    size_n = np.sqrt(square / (2 * WINDOW)) / np.sqrt(0.5 - 0.5 / np.pi)
    assert found[0, 0] == pytest.approx(np.median(size_n[0, :4] / taken_n[0, :4]) ** 0.25, rel=1e-4)
    assert found[1, 0] == 1
    assert scale_of(samples, taken_n, sums)[0, 0] == pytest.approx(found[0, 0], rel=0.02)
