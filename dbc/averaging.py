"""Numbers of nodes that average what they sample between two SYNCs; `nodes.averaging` says what they are for."""

from typing import Final

import numpy as np

from dbc.patch_filter import Models, make_models

#: Which models run: a jump, the average with gain 2⁻⁸, and trends with memories of 2², 2⁴ and 2⁶ samples. All eight
#: give no better images on the scenes of the evaluation, and take 1.6 times as long.
MODELS: Final = (0, 2, 3, 5, 7)
#: Samples over which the noise of a taxel is learned.
MEMORY: Final = 256
#: Variance of rounding to whole counts, counts²; no noise is taken to be less.
ROUNDING: Final = 1 / 12
#: Largest ratio of a squared second difference to their mean: more is a touch, and counts as this ratio.
OUTLIER_RATIO: Final = 16.0
#: A taxel is idle while the ratio of its mean to its deviation is within this part of that of clipped noise, ...
IDLE_BAND: Final = 0.25
#: ... and its second differences d are noise: (mean |d|)² / mean d² is 0.53 for clipped noise, less for rare steps.
EVENNESS: Final = 0.4
#: σ of a block is learned while at least this part of its taxels is idle, and follows them in each cycle by this part
#: of the difference.
IDLE_PART: Final = 1 / 8
LEARNING_GAIN: Final = 0.005
#: A force of fewer standard deviations of its average is taken for noise, and is 0.
DEAD_RATIO: Final = 2.0


def averaging_models() -> Models:
    """Return the models that run."""
    return Models(*(np.ascontiguousarray(each[list(MODELS)]) for each in make_models(0.0)))
