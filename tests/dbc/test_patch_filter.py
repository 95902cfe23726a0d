"""The filter's models of how a coefficient moves: their variances are those of linear systems."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.special import ndtr

from dbc import patch_filter
from dbc.patch_filter import make_models, unclip_table
from skin.clipping import DEAD_RATIO

#: Gains of the averages and memories of the g-h filters, as docs/steps.md has them.
GAINS = (1.0, 1 / 64, 1 / 256)
MEMORIES = (3 / 4, 7 / 8, 15 / 16, 31 / 32, 63 / 64)
#: Variances of trends are those of forecasts that look so many samples further, which errs on the safe side.
LATER = 1


def variances(gain: float, slope_gain: float, horizon: float) -> tuple[float, float]:
    """Return the variances of innovation and forecast of a g-h filter on noise of variance 1."""
    motion = np.array([[1 - gain, 1 - gain], [-slope_gain, 1 - slope_gain]])
    gains = np.array([[gain], [slope_gain]])
    spread = solve_discrete_lyapunov(motion, gains @ gains.T)
    ahead, far = np.array([1, 1 + LATER]), np.array([1, horizon + LATER])
    return 1 + ahead @ spread @ ahead, far @ spread @ far


@pytest.mark.parametrize("horizon", [0.0, 4.0])
def test_variances_of_the_models_are_those_of_their_errors(horizon: float) -> None:
    models = make_models(horizon)
    slope_gains = [(1 - memory) ** 2 for memory in MEMORIES]
    np.testing.assert_allclose(models.gain, [*GAINS, *(1 - memory**2 for memory in MEMORIES)], rtol=1e-6)
    np.testing.assert_allclose(models.slope_gain, [0, 0, 0, *slope_gains], rtol=1e-6)
    averages = [gain / (2 - gain) for gain in GAINS]
    trends = [variances(1 - memory**2, slope, horizon) for memory, slope in zip(MEMORIES, slope_gains, strict=True)]
    innovation = np.array([8.0, *(1 + each for each in averages[1:]), *(each for each, _ in trends)])
    np.testing.assert_allclose(models.half_precision, 1 / (2 * innovation), rtol=1e-6)
    np.testing.assert_allclose(models.log_spread, np.log(innovation) / 2, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(models.variance, [*averages, *(each for _, each in trends)], rtol=1e-6)


def reading(force: np.ndarray) -> np.ndarray:
    """Return the mean reading of taxels, m(x) = x Φ(x) + φ(x), in units of their noise."""
    return force * ndtr(force) + np.exp(-(force**2) / 2) / np.sqrt(2 * np.pi)


def test_readings_are_turned_back_into_forces() -> None:
    """1024 values from the reading 0 to that of six deviations; what reads less than at -2 is taken for -2."""
    table = unclip_table()
    assert table.dtype == np.float32
    lowest, highest = reading(np.array([-2.0, 6.0]))
    readings = np.linspace(0, highest, 1024)
    is_below = readings < lowest
    assert is_below.sum() == 2
    assert (table[is_below] == -2).all()
    np.testing.assert_allclose(reading(table[~is_below].astype(np.float64)), readings[~is_below], atol=1e-6)


def test_powers_of_two_are_exact_enough() -> None:
    """2^f is a polynomial of degree five on 0 to 1."""
    part = np.linspace(0, 1, 1001)
    power = sum(float(each) * part**place for place, each in enumerate(patch_filter.POWER))
    np.testing.assert_allclose(power, 2**part, atol=2e-7)
    assert float(patch_filter.LOG2_E) == pytest.approx(1 / np.log(2), rel=6e-8)
    assert float(patch_filter.ROOT_HALF) == pytest.approx(np.sqrt(0.5), rel=6e-8)


def test_the_figures_are_those_of_the_documentation() -> None:
    """docs/steps.md, "Power-up" to "Noise while running", and the models before; samples come every millisecond."""
    told = patch_filter
    assert (told.SAMPLE_NS, told.IDLE_SAMPLES, told.SETTLING_SAMPLES, told.SPANS) == (1_000_000, 2000, 300, (1, 4, 16))
    assert (told.AVERAGES, told.TRENDS) == ((0, 6, 8), (2, 3, 4, 5, 6))
    assert (told.JUMP_VARIANCE, told.SWITCHING, told.LEAST_WEIGHT, told.HORIZON) == (8, 0.001, 1e-9, 4)
    assert float(told.LEAST_EXPONENT) == -120
    assert (DEAD_RATIO, told.UNCLIP_REACH, told.UNCLIP_POINTS, told.LEAST_NOISE_N) == (0.4, 6, 1024, 2e-5)
    assert pytest.approx((1e-9, 1000)) == told.GIVEN_NOISE_N
    assert (told.FOLLOWING, told.RATE_N, told.RETURN_N, told.RISE_N, told.HIGHEST_N) == (
        1 / 128,
        1e-6,
        5e-7,
        2e-8,
        1e-3,
    )
    assert (told.QUIET_RATIO, told.LOWEST_RATIO, told.WINDOW) == (0.6, -1.5, 256)
    assert (told.IDLE_RATIOS, told.IDLE_PART) == ((0.5, 0.9), 0.5)
