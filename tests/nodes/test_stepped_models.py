"""Models of how a coefficient moves: a step is Bayes' rule."""

import numpy as np
import numpy.typing as npt
import pytest

from dbc.patch_filter import make_models
from nodes.steps.models import new_tracks, step

#: Chance of a change of model in one sample, and the least weight of a model.
SWITCHING, LEAST = 0.001, 1e-9

Numbers = npt.NDArray[np.float64]


class Slow:
    """Interacting multiple models of one coefficient, as Blom and Bar-Shalom write them."""

    def __init__(self, horizon: float) -> None:
        models = make_models(horizon)
        self.gain, self.slope_gain = models.gain.astype(float), models.slope_gain.astype(float)
        self.innovation, self.spread = 1 / (2 * models.half_precision.astype(float)), models.variance.astype(float)
        count = len(self.gain)
        self.level, self.slope, self.weight = np.zeros(count), np.zeros(count), np.full(count, 1 / count)
        self.change = np.full((count, count), SWITCHING / (count - 1))
        np.fill_diagonal(self.change, 1 - SWITCHING)
        self.horizon = horizon

    def step(self, sample: float) -> tuple[float, float]:
        prior = self.weight @ self.change
        level = (self.weight * self.level) @ self.change / prior
        slope = np.where(self.slope_gain > 0, (self.weight * self.slope) @ self.change / prior, 0)
        surprise = sample - (level + slope)
        self.level, self.slope = level + slope + self.gain * surprise, slope + self.slope_gain * surprise
        likelihood = np.exp(-(surprise**2) / (2 * self.innovation)) / np.sqrt(self.innovation)
        posterior = prior * likelihood
        self.weight = np.maximum(posterior / posterior.sum(), LEAST)
        return self.weight @ (self.level + self.horizon * self.slope), self.weight @ self.spread


@pytest.mark.parametrize("horizon", [0.0, 4.0])
def test_a_step_is_that_of_interacting_multiple_models(horizon: float) -> None:
    rng, models = np.random.default_rng(1), make_models(horizon)
    ticks = np.arange(300)
    paths = np.stack([0 * ticks, 40.0 * (ticks > 99), 0.3 * np.maximum(ticks - 50, 0), -0.01 * ticks**1.5], axis=1)
    samples = (paths + rng.normal(0, 1, paths.shape)).astype(np.float32)
    tracks, slow, least = new_tracks(models, 4), [Slow(horizon) for _ in range(4)], 1.0
    forecast, variance = np.zeros((2, 4), np.float32)
    for sample in samples:
        step(sample, models, tracks, np.float32(horizon), forecast, variance)
        expected = np.array([each.step(float(value)) for each, value in zip(slow, sample, strict=True)])
        np.testing.assert_allclose(forecast, expected[:, 0], rtol=2e-4, atol=2e-3)
        np.testing.assert_allclose(variance, expected[:, 1], rtol=5e-3)
        np.testing.assert_allclose(
            tracks.weight, np.stack([each.weight for each in slow], axis=1), rtol=0.02, atol=1e-6
        )
        least = min(least, tracks.weight.min())
    assert least == pytest.approx(LEAST)
