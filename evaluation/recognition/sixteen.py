"""The paper's sixteen objects live: what the service says of sums that the nodes' electronics made."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from canskin.messages import UNKNOWN_OBJECT
from classifier.cache import FEATURES
from classifier.decide import Classifier
from classifier.training import TrainingOptions, train
from evaluation.result import Row
from nodes.simulated import REST_S, Nodes
from skin.layout import Layout, changed, load_layout
from skin.measured_sums import decode_measurement
from skin.sources import OBJECT_GROUPS, StrokeKind, load_touches, step_rate_hz
from touch.sources import objects
from touch.strokes import LIFT_S, PAUSE_S, PRESS_S, SLOT_S

NAMES: Final = OBJECT_GROUPS["paper"]


def skin_of(sums: int, samples: int, draw: int) -> Layout:
    """Return the default skin with other sums and samples from SYNC to SYNC, and another draw of Φ.

    Fewer sums than blocks are drawn as in the paper: some blocks then send nothing.
    """
    layout = load_layout()
    selection = "uniform" if sums < layout.blocks else "balanced"
    return changed(
        layout,
        measurement={"sums": sums, "selection": selection, "seed": layout.measurement.seed + draw},
        sampling={"rate_hz": layout.sync.rate_hz * samples if samples > 1 else None},
    )


def measure_sixteen(
    *, stroke: StrokeKind, sums: int, samples: int, draw: int, touches: int, per_object: int, seed: int
) -> Row:
    """Return what is said in the cycles in which one of the sixteen touches with 2 mN or more; they touch in turn.

    Returns
    -------
    dict
        Parts of these cycles: ``right``, ``unknown``, ``empty``; ``held``: the right part of the cycles in which the
        object is pressed in fully, the only ones that the paper classifies.
    """
    layout = skin_of(sums, samples, draw)
    rate_hz = step_rate_hz(layout)
    options = TrainingOptions(features=FEATURES[stroke], seed=seed)
    trained_on = load_touches(NAMES, per_object * len(NAMES), layout, seed=seed, stroke=stroke)
    model = train(*trained_on, layout, options=options)
    source = objects(rate_hz=rate_hz, names=NAMES, seed=seed + 1000, rest_s=REST_S, stroke=stroke)
    nodes, phi = Nodes(layout, source, seed=seed), layout.phi()
    classifier = Classifier(model, phi)
    said: list[str] = []
    true: list[str] = []
    is_held: list[bool] = []
    for step in range(round((REST_S + touches * SLOT_S) * rate_hz)):
        measured = decode_measurement(nodes.measurement(nodes.sample()), phi)
        label = classifier.decide(measured.counts, measured.valid, nodes.cycle).label
        touching = nodes.truth().label
        if touching:
            said.append(label)
            true.append(touching)
            is_held.append(PAUSE_S + PRESS_S <= (step / rate_hz - REST_S) % SLOT_S <= SLOT_S - LIFT_S)
    return _shares(said, true, is_held)


def _shares(said: Sequence[str], true: Sequence[str], is_held: Sequence[bool]) -> Row:
    labels = np.array(said)
    right, held = labels == np.array(true), np.array(is_held)
    return {
        "right": float(right.mean()),
        "held": float(right[held].mean()),
        "unknown": float((labels == UNKNOWN_OBJECT).mean()),
        "empty": float((labels == "").mean()),
    }
