"""Constant-gain models of how a coefficient moves, and one step of all of them, mixed by their likelihood.

Every coefficient runs a few exponential averages and a few g-h filters side by side (interacting multiple models, Blom
and Bar-Shalom 1988). Each model's gain is constant, so its variances are known beforehand, in units of the noise's:

* An average with gain g has the variance V = g / (2 - g), and its innovation 1 + V.
* A g-h filter of fading memory θ has the gains 1 - θ² and (1 - θ)², and the variances of level V, of slope B, and
  their covariance C below (Brookner 1998, table 1.10-2); its innovation has 1 + V + 2C + B.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from skin.compiled import njit

#: Exponents k of the averages' gains 2^-k: the first follows every jump.
AVERAGES: Final = (0, 6, 8)
#: Exponents k of the g-h filters' memories 1 - 2^-k.
TRENDS: Final = (2, 3, 4, 5, 6)
#: Innovation variance of the model that follows jumps: far more than noise, so that noise alone never prefers it.
JUMP_VARIANCE: Final = 8.0
#: Chance of a change of model in one sample, spread evenly over the others.
SWITCHING: Final = 0.001
#: No model's weight falls below.
LEAST_WEIGHT: Final = 1e-9

Floats = npt.NDArray[np.float32]

# Division by 0, which never happens here, is not checked below: loops with that check are not vectorised.
_LOG2_E: Final = np.float32(1.4426950408889634)
#: exp(x) below is 0 for all that matters, and above has a normal exponent.
_LEAST_EXPONENT: Final = np.float32(-120.0)
#: Polynomial of 2^f on 0 to 1 through its Chebyshev nodes, error below 2e-7.
_POWER: Final = tuple(map(np.float32, (0.9999999, 0.69315449, 0.24014182, 0.05586034, 0.00894959, 0.00189375)))


class Models(NamedTuple):
    """The models, arrays of float32, shape (models,).

    Attributes
    ----------
    gain, slope_gain : level and slope gain
    half_precision : 1 / (2 S), S the variance of the innovation
    log_spread : ½ ln S
    variance : of the forecast, in units of the noise's
    """

    gain: Floats
    slope_gain: Floats
    half_precision: Floats
    log_spread: Floats
    variance: Floats


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


def make_models(horizon: float) -> Models:
    """Return the models for forecasts `horizon` samples ahead."""
    rows = []
    for exponent in AVERAGES:
        gain = 2.0**-exponent
        variance = gain / (2 - gain)
        rows.append((gain, 0.0, JUMP_VARIANCE if exponent == 0 else 1 + variance, variance))
    for exponent in TRENDS:
        memory = 1 - 2.0**-exponent
        fading, cubed = 1 - memory, (1 + memory) ** 3
        level = fading * (5 + 4 * memory + memory**2) / cubed
        shared = fading**2 * (3 + memory) / cubed
        slope = 2 * fading**3 / cubed
        forecast = level + 2 * horizon * shared + horizon**2 * slope
        rows.append((1 - memory**2, fading**2, 1 + level + 2 * shared + slope, forecast))
    gain, slope_gain, innovation, forecast = np.array(rows, np.float64).T
    columns = (gain, slope_gain, 0.5 / innovation, 0.5 * np.log(innovation), forecast)
    return Models(*(np.ascontiguousarray(each, np.float32) for each in columns))


def new_tracks(models: Models, coefficients: int) -> Tracks:
    """Return tracks at 0, all models alike."""
    count = models.gain.size
    level, slope, surprise = (np.zeros((count, coefficients), np.float32) for _ in range(3))
    weight = np.full((count, coefficients), 1 / count, np.float32)
    level_mean, slope_mean = (np.zeros(coefficients, np.float32) for _ in range(2))
    return Tracks(level, slope, weight, surprise, level_mean, slope_mean)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def step(  # noqa: PLR0917  compiled functions take no keywords
    sample: Floats, models: Models, tracks: Tracks, horizon: Any, forecast: Floats, variance: Floats
) -> None:
    """Take one sample of every coefficient in; write the forecasts and their variances.

    Parameters
    ----------
    sample : shape (coefficients,)
        In units of the noise's standard deviation.
    horizon : float32
        As for `make_models`.
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


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
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
            exponent = max((least[c] - surprise[c]) * _LOG2_E, _LEAST_EXPONENT)
            whole = np.floor(exponent)
            power[c] = (np.int32(whole) + np.int32(127)) << np.int32(23)
            f = exponent - whole
            part = _POWER[4] + f * _POWER[5]
            part = _POWER[2] + f * (_POWER[3] + f * part)
            weight[c] *= (_POWER[0] + f * (_POWER[1] + f * part)) * tracks.slope_mean[c]
            total[c] += weight[c]
    for model in range(count):
        weight = tracks.weight[model]
        for c in range(size):
            weight[c] = max(weight[c] / total[c], np.float32(LEAST_WEIGHT))
