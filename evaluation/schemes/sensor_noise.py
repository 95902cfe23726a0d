"""Noise that is not what a filter expects of noise: coloured, heavy-tailed, common to all taxels."""

import math
from typing import Final, Literal, assert_never

import numpy as np

from touch.contact import Force

#: Normal and independent, as the paper's; or one that is harder to filter.
NoiseKind = Literal["normal", "coloured", "heavy-tailed", "common-mode"]
#: Of coloured noise: how much of it stays from one millisecond to the next.
COLOUR: Final = 0.9
#: Degrees of freedom of heavy-tailed noise (Student t).
DEGREES: Final = 4
#: Deviation of the part that is common to all taxels, in units of each taxel's own.
COMMON_RATIO: Final = 0.3


def noise_of(kind: NoiseKind, shape: tuple[int, int], noise_n: float, rng: np.random.Generator) -> Force:
    """Return noise of shape (ticks, taxels), newtons; `noise_n` is its standard deviation, without the common part."""
    if kind == "heavy-tailed":
        drawn = rng.standard_t(DEGREES, shape).astype(np.float32)
        return drawn * np.float32(noise_n / math.sqrt(DEGREES / (DEGREES - 2)))
    own: Force = rng.standard_normal(shape, np.float32) * np.float32(noise_n)
    match kind:
        case "normal":
            return own
        case "common-mode":
            common = rng.standard_normal((shape[0], 1), np.float32)
            return own + common * np.float32(COMMON_RATIO * noise_n)
        case "coloured":
            own[1:] *= np.float32(math.sqrt(1 - COLOUR**2))
            for tick in range(1, len(own)):
                own[tick] += np.float32(COLOUR) * own[tick - 1]
            return own
        case _:
            assert_never(kind)
