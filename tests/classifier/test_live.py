"""The goal: the right name on the simulator's live series."""

import numpy as np
import pytest

from classifier.cache import TOUCHES_PER_OBJECT
from classifier.decide import Classifier
from classifier.samples import simulate_sums
from classifier.training import train
from skin.layout import load_layout
from skin.sources import DEFAULT_OBJECTS, load_source, load_touches

pytestmark = pytest.mark.slow

STEPS = 5 * 310  # each object once


def test_labelled_frames_get_their_name_though_a_quarter_of_the_blocks_is_dead() -> None:
    """`skin evaluate recognition` has the figures of whole skins."""
    layout, seed = load_layout(), 11
    count = TOUCHES_PER_OBJECT * len(DEFAULT_OBJECTS)
    trained = train(*load_touches(DEFAULT_OBJECTS, count, layout, seed=0), layout)
    phi = layout.phi()
    source = load_source("objects", rows=64, columns=64, pitch_m=0.004, rate_hz=100.0, seed=seed)
    rng = np.random.default_rng(seed)
    valid = np.ones(phi.blocks, np.uint8)
    valid[:32] = 0
    classifier = Classifier(trained, phi)
    right = []
    for step in range(STEPS):
        force_n, label = source.frame(step)
        sums = simulate_sums(force_n[None], layout, phi, 0.001, rng)[0]
        said = classifier.decide(sums, valid, step + 1).label
        if label:
            right.append(said == label)
    assert len(right) > STEPS / 2
    assert np.mean(right) >= 0.95
