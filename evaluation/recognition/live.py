"""The service's own classifier on the simulator's live series: known objects, unknown ones, missing blocks."""

from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np

from canskin.errors import InputError
from canskin.messages import UNKNOWN_OBJECT
from classifier.cache import TOUCHES_PER_OBJECT
from classifier.decide import Classifier
from classifier.model import Model
from classifier.samples import simulate_sums
from classifier.training import train
from evaluation.result import Row
from skin.layout import load_layout
from skin.sources import DEFAULT_OBJECTS, load_touches
from skin.taxel import NOISE_N
from touch.sources import objects
from touch.strokes import SLOT_S

#: Dead blocks and quieter taxels, as (part of the blocks, part of the noise).
CONDITIONS: Final = ((0.0, 1.0), (0.1, 1.0), (0.25, 1.0), (0.0, 0.5))


@cache
def trained_model(seed: int) -> Model:
    """Return a model of the default skin and the default objects, trained as the service trains it."""
    layout = load_layout()
    touches = load_touches(DEFAULT_OBJECTS, TOUCHES_PER_OBJECT * len(DEFAULT_OBJECTS), layout, seed=seed)
    return train(*touches, layout)


def measure_live(*, names: Sequence[str], touches: int, lost_ratio: float, noise_ratio: float, seed: int) -> Row:
    """Return what is said in the cycles of a live series in which an object touches.

    The objects `names` touch in turn. A part of the blocks, `lost_ratio`, is dead all the time; the noise of the taxels
    is `noise_ratio` of that the model was trained with.

    Returns
    -------
    dict
        ``right`` and ``unknown``, parts of those cycles; ``sums``, how many the skin sends.
    """
    layout, model = load_layout(), trained_model(seed)
    phi, rate_hz = layout.phi(), layout.sync.rate_hz
    rng = np.random.default_rng([seed, 7])
    source = objects(rate_hz=rate_hz, names=names, seed=seed + 1000)
    valid = np.ones(phi.blocks, np.bool_)
    valid[rng.permutation(phi.blocks)[: round(lost_ratio * phi.blocks)]] = 0
    classifier = Classifier(model, phi)
    right, unknown, cycles = 0, 0, 0
    for step in range(round(touches * SLOT_S * rate_hz)):
        force_n, label = source.frame(step)
        sums = simulate_sums(force_n[None], layout, phi, noise_ratio * NOISE_N, rng)[0]
        said = classifier.decide(sums, valid, step + 1).label
        if label:
            cycles += 1
            right += said == label
            unknown += said == UNKNOWN_OBJECT
    if not cycles:
        raise InputError(f"no object touches in any cycle: expected 1 touch or more, got {touches}")
    return {"right": right / cycles, "unknown": unknown / cycles, "sums": phi.shape[0]}
