"""The temporal memory of sums as one compiled function; see `reconstructor.memory`."""

from typing import Any, Final, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from reconstructor.checks import LARGEST_N

Flat = npt.NDArray[np.floating[Any]]

#: Least gain.
GAIN_MIN: Final = 0.18
#: How much of the correlation that noise alone would give is asked for. 0 asks for innovations that do not correlate;
#: more allows less lag, because lag is worse than noise, which the prior removes.
LEAD: Final = 0.6
#: How far the innovation's energy may be above what noise explains without being taken for a change.
BAND: Final = 1.15
#: How fast a change takes the gain to 1.
STEEPNESS: Final = 4
#: The floor of the noise falls by this much of what it is too high, at once to where it is no more than so often too
#: high, and rises by this much a cycle.
FALL: Final = 0.2
FAR: Final = 1.5
RISE: Final = 0.002
#: A sum that has not come for so long that less than this of it counts is forgotten.
FORGOTTEN: Final = 0.01
#: Places of `Recall.state`: the gain that the correlation asks for, the noise floor (N², 0: unknown), the last gain.
WHITE, FLOOR, GAIN = 0, 1, 2


class Recall(NamedTuple):
    """Memory of one stream of measurements.

    Attributes
    ----------
    sums, weights, innovation : shape (m,)
        Averaged sums in newtons, how much each counts (0 to 1), and how far the last ones were from them.
    state : float64, shape (3,)
    """

    sums: Flat
    weights: Flat
    innovation: Flat
    state: npt.NDArray[np.float64]


@numba.njit(cache=True, nogil=True)
def remember(recall: Recall, sums: Flat, valid: npt.NDArray[np.bool_]) -> bool:
    """Take in one cycle; False, and nothing is changed, if a valid sum is no number of newtons."""
    energy, before, product, count = 0.0, 0.0, 0.0, 0
    for k in range(sums.size):
        if valid[k]:
            if not abs(sums[k]) <= LARGEST_N:  # so written, NaN fails
                return False
            if recall.weights[k] > 0:
                innovation = float(sums[k] - recall.sums[k])
                energy += innovation * innovation
                product += innovation * recall.innovation[k]
                before += recall.innovation[k] * recall.innovation[k]
                count += 1
    gain = 1.0
    if count > 0:
        gain = _adapt(recall.state, energy / count, product / max(np.sqrt(energy * before), 1e-30))
    recall.state[GAIN] = gain
    for k in range(sums.size):
        if valid[k]:
            innovation = float(sums[k] - recall.sums[k])
            recall.sums[k] += max(gain, 1.0 - recall.weights[k]) * innovation
            recall.innovation[k] = innovation if recall.weights[k] > 0 else 0.0
            recall.weights[k] = 1.0
        else:
            left = recall.weights[k] * (1.0 - gain)
            recall.weights[k] = left if left > FORGOTTEN else 0.0
            recall.innovation[k] = 0.0
    return True


@numba.njit(cache=True, nogil=True)
def _adapt(state: npt.NDArray[np.float64], energy: float, correlation: float) -> float:
    """Return the gain for an innovation of mean square `energy` that correlates so with the one before."""
    last = state[GAIN]
    state[WHITE] = min(1.0, max(GAIN_MIN, state[WHITE] * np.exp(correlation + LEAD * last / 2.0)))
    noise = energy * (2.0 - last) / 2.0  # of the sums alone: what was averaged has g / (2 - g) of it
    if state[FLOOR] == 0.0:
        state[FLOOR] = noise
    explained = BAND * state[FLOOR] * 2.0 / (2.0 - last)
    gain = float(state[WHITE])
    if energy > explained:
        gain = max(gain, 1.0 - (explained / energy) ** STEEPNESS)
    if noise < state[FLOOR]:
        state[FLOOR] = min(state[FLOOR] + FALL * (noise - state[FLOOR]), FAR * noise)
    else:
        state[FLOOR] *= 1.0 + RISE
    return gain
