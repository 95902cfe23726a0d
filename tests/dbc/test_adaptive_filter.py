"""The filter's models of how a coefficient moves: their variances are those of linear systems."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from dbc.adaptive_filter import make_models

#: Gains of the averages and memories of the g-h filters, as docs/adaptive.md has them.
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
