"""One step of the models of how a coefficient moves (`dbc.patch_filter`), mixed by their likelihood."""

from typing import Any, NamedTuple

import numpy as np

from dbc.patch_filter import LEAST_EXPONENT, LEAST_WEIGHT, LOG2_E, POWER, SWITCHING, Floats, Models
from shell.compiled import njit


class Tracks(NamedTuple):
    """The state of all coefficients, arrays of float32.

    Attributes
    ----------
    level, slope, weight : shape (models, coefficients)
    surprise, level_mean, slope_mean : working memory
    """

    level: Floats
    slope: Floats
    weight: Floats
    surprise: Floats
    level_mean: Floats
    slope_mean: Floats


def new_tracks(models: Models, coefficients: int) -> Tracks:
    """Return tracks at 0, all models alike."""
    count = models.gain.size
    level, slope, surprise = (np.zeros((count, coefficients), np.float32) for _ in range(3))
    weight = np.full((count, coefficients), 1 / count, np.float32)
    level_mean, slope_mean = (np.zeros(coefficients, np.float32) for _ in range(2))
    return Tracks(level, slope, weight, surprise, level_mean, slope_mean)


# No fast math: every operation is rounded as written, as in the boards' C code. Division by 0, which never happens
# here, is not checked: loops with that check are not vectorised.
@njit(cache=True, nogil=True, error_model="numpy")
def step(  # noqa: PLR0917  compiled functions take no keywords
    sample: Floats, models: Models, tracks: Tracks, horizon: Any, forecast: Floats, variance: Floats
) -> None:
    """Take one sample of every coefficient in; write the forecasts and their variances.

    Parameters
    ----------
    sample : shape (coefficients,)
        In units of the noise's standard deviation.
    horizon : float32
        As for `dbc.patch_filter.make_models`.
    forecast, variance : shape (coefficients,)
        Written; the variance in units of the noise's.
    """
    size, count = sample.size, models.gain.size
    change = np.float32(SWITCHING / (count - 1))
    stay = np.float32(1.0 - SWITCHING)
    level_mean, slope_mean = tracks.level_mean, tracks.slope_mean
    level_mean[:] = 0
    slope_mean[:] = 0
    for model in range(count):
        level, slope, weight = tracks.level[model], tracks.slope[model], tracks.weight[model]
        for c in range(size):
            level_mean[c] += weight[c] * level[c]
            slope_mean[c] += weight[c] * slope[c]
    for model in range(count):
        level, slope, weight = tracks.level[model], tracks.slope[model], tracks.weight[model]
        surprise = tracks.surprise[model]
        gain, slope_gain = models.gain[model], models.slope_gain[model]
        half_precision, log_spread = models.half_precision[model], models.log_spread[model]
        has_slope = np.float32(1.0) if slope_gain > 0 else np.float32(0.0)
        for c in range(size):
            likely = change + (stay - change) * weight[c]
            scale = np.float32(1.0) / likely
            kept = (stay - change) * weight[c]
            mixed_slope = (change * slope_mean[c] + kept * slope[c]) * scale * has_slope
            predicted = (change * level_mean[c] + kept * level[c]) * scale + mixed_slope
            innovation = sample[c] - predicted
            level[c] = predicted + gain * innovation
            slope[c] = mixed_slope + slope_gain * innovation
            weight[c] = likely
            surprise[c] = innovation * innovation * half_precision + log_spread
    _weigh(tracks, forecast)
    forecast[:] = 0
    variance[:] = 0
    for model in range(count):
        level, slope, weight = tracks.level[model], tracks.slope[model], tracks.weight[model]
        spread = models.variance[model]
        for c in range(size):
            forecast[c] += weight[c] * (level[c] + horizon * slope[c])
            variance[c] += weight[c] * spread


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh(tracks: Tracks, least: Floats) -> None:
    """Multiply the weights by the likelihoods exp(-surprise), relative to the likeliest, and make their sum 1."""
    count, size = tracks.weight.shape
    total, power = tracks.level_mean, tracks.slope_mean.view(np.int32)
    least[:] = tracks.surprise[0]
    for model in range(1, count):
        surprise = tracks.surprise[model]
        for c in range(size):
            least[c] = min(least[c], surprise[c])
    total[:] = 0
    for model in range(count):
        surprise, weight = tracks.surprise[model], tracks.weight[model]
        for c in range(size):
            # 2^x as exponent bits times a polynomial: the compiler vectorises this, and no call of exp.
            exponent = max((least[c] - surprise[c]) * LOG2_E, LEAST_EXPONENT)
            whole = np.floor(exponent)
            power[c] = (np.int32(whole) + np.int32(127)) << np.int32(23)
            f = exponent - whole
            part = POWER[4] + f * POWER[5]
            part = POWER[2] + f * (POWER[3] + f * part)
            weight[c] *= (POWER[0] + f * (POWER[1] + f * part)) * tracks.slope_mean[c]
            total[c] += weight[c]
    for model in range(count):
        weight = tracks.weight[model]
        for c in range(size):
            weight[c] = max(weight[c] / total[c], np.float32(LEAST_WEIGHT))
