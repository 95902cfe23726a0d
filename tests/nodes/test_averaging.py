"""What a node averages: constants exactly, noise away, motion hardly late; σ learned only where it shows."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from dbc.patch_filter import Models, make_models
from nodes.averaging import SampleFilter
from nodes.steps.models import new_tracks, step

BLOCKS, SIZE = 16, 32
TAXELS = BLOCKS * SIZE
#: σ of the default skin's sensor, counts.
NOISE = 51.15
#: Taxels of each block.
PLACES = np.random.default_rng(3).permutation(TAXELS).reshape(BLOCKS, SIZE)
TOP = 1023

Counts = npt.NDArray[np.float32]


def new_filter() -> SampleFilter:
    return SampleFilter(PLACES)


def sense(force: npt.ArrayLike, ticks: int, noise: float = NOISE, seed: int = 0) -> Counts:
    """Return what taxels under `force` (counts; (n,) or (ticks, n)) read."""
    read = np.broadcast_to(force, (ticks, TAXELS)) + np.random.default_rng(seed).normal(0, noise, (ticks, TAXELS))
    return np.rint(np.clip(read, 0, TOP)).astype(np.float32)


def fed(made: SampleFilter, samples: Counts) -> Counts:
    """Take samples in tens; return the averages after each ten."""
    averages = []
    for begin in range(0, len(samples), 10):
        made.take(samples[begin : begin + 10])
        averages.append(made.counts)
    return np.array(averages)


def idle(noise: float = NOISE) -> SampleFilter:
    made = new_filter()
    fed(made, sense(0, 2000, noise, seed=9))
    return made


def test_a_constant_goes_through_exactly_from_the_first_sample_on() -> None:
    constant = np.linspace(0, TOP, TAXELS).round().astype(np.float32)
    averages = fed(new_filter(), np.tile(constant, (600, 1)))
    np.testing.assert_allclose(
        averages, np.tile(constant, (60, 1)), atol=0.015
    )  # a sum of 32 is rounded to whole counts


def test_noise_of_a_resting_touch_falls_as_with_a_mean_of_hundreds_of_samples() -> None:
    made = new_filter()
    first = fed(made, sense(500, 10))[0]
    later = fed(made, sense(500, 2000, seed=1))[100:]
    assert np.std(first - 500) < NOISE  # no worse than one sample
    assert np.std(later - 500) < NOISE / 12
    assert abs(np.mean(later - 500)) < NOISE / 50


@pytest.mark.parametrize(("speed", "most"), [(0.5, 0.6), (2.0, 1.1), (10.0, 1.8)])
def test_a_ramp_lags_by_little_more_than_the_noise_of_a_sample(speed: float, most: float) -> None:
    made = new_filter()
    fed(made, sense(200, 1000))
    ramp = 200 + speed * np.arange(60)[:, None] * np.ones(TAXELS)
    error = fed(made, sense(ramp, 60, seed=2)) - ramp[9::10]
    lag = np.abs(error.mean(axis=1)) / NOISE
    assert lag.max() < most
    assert lag[-1] < 0.55


def test_a_jump_is_followed_within_one_cycle() -> None:
    made = idle()
    assert abs(fed(made, sense(600, 10, seed=5))[0].mean() - 600) < 0.3 * NOISE


@pytest.mark.parametrize("noise", [10.0, NOISE, 200.0])
def test_noise_is_learned_on_an_idle_skin(noise: float) -> None:
    made = idle(noise)
    np.testing.assert_allclose(made.noise, noise, rtol=0.08)
    assert made.counts.mean() < 0.02 * noise  # 0.4 without the correction


def test_noise_is_learned_with_a_third_of_the_skin_touched_from_the_start() -> None:
    force = np.where(np.arange(TAXELS) < TAXELS // 3, 400.0, 0.0)
    made = new_filter()
    averages = fed(made, sense(force, 2000, seed=4))[-20:]
    np.testing.assert_allclose(made.noise, NOISE, rtol=0.1)
    np.testing.assert_allclose(averages.mean(axis=0), force, atol=0.15 * NOISE)


def test_nothing_is_corrected_while_the_noise_is_unknown() -> None:
    made = new_filter()
    averages = fed(made, sense(3 * NOISE, 1000, seed=7))
    assert not made.noise.any()
    assert averages[-20:].mean() == pytest.approx(3 * NOISE, rel=0.02)
    cloth = new_filter()  # all over the skin, from the start
    averages = fed(cloth, sense(NOISE, 1000, seed=8))
    assert averages[-20:].mean() == pytest.approx(1.083 * NOISE, rel=0.02)


def test_what_has_no_noise_is_not_corrected() -> None:
    """A recording's frames, one a cycle, straight lines between."""
    frames = np.random.default_rng(1).integers(0, 40, (80, TAXELS))
    parts = np.linspace(0.1, 1, 10)[:, None]
    lines = np.concatenate([a + parts * (b - a) for a, b in pairwise(frames)])
    made = new_filter()
    fed(made, np.rint(lines).astype(np.float32))
    assert not made.noise.any()


def test_a_restart_forgets_one_block_and_no_other() -> None:
    made, like = idle(), idle()
    made.restart(2)
    taxels = PLACES[2]
    assert made.noise[2] == 0
    constant = np.full((10, TAXELS), 300, np.float32)
    fed(made, constant)
    fed(like, constant)
    np.testing.assert_allclose(made.counts[taxels], 300, atol=1e-3)
    others = np.setdiff1d(np.arange(TAXELS), taxels)
    np.testing.assert_array_equal(made.counts[others], like.counts[others])


class SlowTaxel:
    """One taxel as the module's text has it: means of second differences, and models on samples in units of noise."""

    def __init__(self) -> None:
        self.models = Models(*(each[[0, 2, 3, 5, 7]] for each in make_models(0.0)))
        self.samples: list[float] = []
        self.square = 0.0
        self.scale = 1.0

    def take(self, samples: npt.NDArray[np.float64], sigma: float) -> float:
        """Return the average."""
        begins = not self.samples
        for each in samples:
            self.samples.append(each)
            seen = len(self.samples) - 2
            if seen > 0:
                found = abs(each - 2 * self.samples[-2] + self.samples[-3])
                if seen > 255:
                    found = min(found, 4 * np.sqrt(max(self.square, 0.5)))
                self.square += max(1 / seen, 1 / 256) * (found**2 - self.square)
        deviation = np.sqrt(max(self.square / 6, 1 / 12))
        scale = max(sigma, deviation) if sigma > 0 else deviation / np.sqrt(0.5 - 0.5 / np.pi)
        if begins:
            self.tracks = new_tracks(self.models, 1)
            self.tracks.level[:] = samples[0] / scale
        else:
            self.tracks.level[:] *= self.scale / scale
            self.tracks.slope[:] *= self.scale / scale
        self.scale = scale
        average, variance = np.zeros((2, 1), np.float32)
        for each in samples:
            step(np.array([each / scale], np.float32), self.models, self.tracks, np.float32(0), average, variance)
        return float(average[0]) * scale


def test_averages_are_those_of_a_slow_computation_taxel_by_taxel() -> None:
    blocks = np.arange(8).reshape(2, 4)
    made, slow = SampleFilter(blocks), [SlowTaxel() for _ in range(8)]
    rng = np.random.default_rng(11)
    force = np.zeros((600, 8))
    force[:, 5] = 300
    force[300:, 6] = 500
    force[:, 7] = np.arange(600)
    read = np.rint(np.clip(force + rng.normal(0, 20, force.shape), 0, TOP)).astype(np.float32)
    for begin in range(0, 600, 10):
        noise = made.noise.copy()
        samples = read[begin : begin + 10]
        made.take(samples)
        of_taxels = np.repeat(noise, 4)
        expected = np.array([each.take(samples[:, c].astype(np.float64), of_taxels[c]) for c, each in enumerate(slow)])
        unknown = np.repeat(made.noise == 0, 4)
        np.testing.assert_allclose(made.counts[unknown], expected[unknown], rtol=1e-3, atol=0.02)
    assert made.noise[0] > 0
    # What is left of noise on an idle taxel is shown as 0, a force as it is.
    assert made.counts[:4].tolist() == [0, 0, 0, 0]
    assert made.counts[5] == pytest.approx(300, abs=10)


def test_the_noise_of_a_block_moves_to_that_of_its_idle_taxels_a_part_in_each_cycle() -> None:
    made = idle()
    known = made.noise.copy()
    force = np.zeros(TAXELS)
    force[PLACES[0, :28]] = 600  # four taxels are left, an eighth of the block
    force[PLACES[1, :29]] = 600  # three: too few
    fed(made, sense(force, 10, 1.3 * NOISE, seed=12))
    assert made.noise[1] == known[1]
    moved = np.delete(made.noise / known, 1)
    assert (np.abs(moved - 1) < 0.005 * 0.3).all()
    assert moved.mean() > 1
    assert np.count_nonzero(moved != 1) > BLOCKS / 2
