"""The numbers of a stepped board's filter, which the virtual nodes and the boards' C code share (docs/steps.md).

Every coefficient runs a few exponential averages and a few g-h filters side by side (interacting multiple models, Blom
and Bar-Shalom 1988). Each model's gain is constant, so its variances are known beforehand, in units of the noise's:

* An average with gain g has the variance V = g / (2 - g), and its innovation 1 + V.
* A g-h filter of fading memory θ has the gains 1 - θ² and (1 - θ)², and the variances of predicted level V, of slope B,
  and their covariance C below (Brookner 1998, table 1.10-2).

The trends' variances of innovation and forecast are taken one sample further than need be: 1 + V + 2C + B in place of
1 + V, which is 7 % (k = 2) to 0.03 % (k = 6) more. With the exact ones the boards trust their trends sooner: five
slides gain 0.06 dB, at 2.6 % more bits.
"""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from skin.clipping import clipped_mean

Floats = npt.NDArray[np.float32]

#: Time between two samples.
SAMPLE_NS: Final = 1_000_000
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
#: Samples that a forecast looks ahead: the delay from a sample to its image.
HORIZON: Final = 4.0

LOG2_E: Final = np.float32(1.4426950408889634)
#: exp(x) below is 0 for all that matters, and above has a normal exponent.
LEAST_EXPONENT: Final = np.float32(-120.0)
#: Polynomial of 2^f on 0 to 1 through its Chebyshev nodes, error below 2e-7.
POWER: Final = tuple(map(np.float32, (0.9999999, 0.69315449, 0.24014182, 0.05586034, 0.00894959, 0.00189375)))

#: What both halves of a patch that is twice as wide as high are weighed with.
ROOT_HALF: Final = np.float32(0.5**0.5)
#: Clipping is undone up to this number of standard deviations; above, it has no effect.
UNCLIP_REACH: Final = 6.0
#: Values of `unclip_table`.
UNCLIP_POINTS: Final = 1024
#: Offsets below -2 standard deviations cannot be told from -2.
_LOWEST: Final = -2.0

#: Samples of the untouched skin that a board learns from when it is switched on, and that its filter has then seen.
IDLE_SAMPLES: Final = 2000
SETTLING_SAMPLES: Final = 300
#: Samples of the means in which noise is looked at: longer means show coloured and common noise.
SPANS: Final = (1, 4, 16)
#: No noise is taken to be smaller, newtons: one count of the default skin.
LEAST_NOISE_N: Final = 0.02e-3
#: Noise that may be given (2032h, 2033h), besides 0 for the learned one, newtons, in REAL32.
GIVEN_NOISE_N: Final = (float(np.float32(1e-9)), 1000.0)

#: An offset follows this part of what is left in each sample, and falls by `RATE_N` newtons a sample at most: 1 mN a
#: second.
FOLLOWING: Final = 1 / 128
RATE_N: Final = 1e-6
#: An offset returns to that of power-up by `RETURN_N` newtons a sample at most: 0.5 mN a second. It rises above that of
#: power-up by `RISE_N` at most: 0.02 mN a second. What grows more slowly cannot be told from a drift.
RETURN_N: Final = 5e-7
RISE_N: Final = 2e-8
#: No offset rises further above that of power-up, newtons: 5 % of the default full scale.
HIGHEST_N: Final = 1e-3
#: An offset is followed while the taxel and its neighbours in the patch show less than this part of their noise.
QUIET_RATIO: Final = 0.6
#: An offset is followed down to this value, in units of the noise: below it nothing is left to be read.
LOWEST_RATIO: Final = -1.5
#: Samples over which the size of the noise is looked at. It is believed so far: its logarithm moves by a quarter.
WINDOW: Final = 256
#: Noise that is clipped at 0 has a mean of 0.68 standard deviations, whatever its size; a taxel outside of these bounds
#: is touched, or has an offset. The deviation is that of samples from the ones before, so that a touch that comes and
#: goes is no noise; nor is coloured noise, of whose size nothing more is learned.
IDLE_RATIOS: Final = (0.5, 0.9)
#: Part of a node's taxels that have to be idle.
IDLE_PART: Final = 0.5


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


def unclip_table() -> Floats:
    """Return m⁻¹, from -2 on, at evenly spaced readings from 0 to m(`UNCLIP_REACH`).

    m is `skin.clipping.clipped_mean`.
    """
    force = np.linspace(_LOWEST, UNCLIP_REACH, 8 * UNCLIP_POINTS)
    mean = clipped_mean(force)
    return np.interp(np.linspace(0, mean[-1], UNCLIP_POINTS), mean, force).astype(np.float32)
