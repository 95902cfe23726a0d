"""The paper's objects from the coarse sums of a skin with adaptive sending."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from classifier.samples import simulate_sums
from classifier.used_sums import classified_phi
from classifier.validation import part_of
from evaluation.observations import LABELS, draw_split, true_force_n
from evaluation.recognition.accuracy import trained
from evaluation.recognition.methods import SHARES
from evaluation.result import Row
from skin.layout import load_layout
from skin.taxel import NOISE_N


def measure_adaptive(*, splits: Sequence[int], meshes: str | None, seed: int) -> Row:
    """Return the accuracy of the paper's classifier on the test set of each split, and the number of ``sums``.

    The sums are those that the classifier takes of the shipped layout ``adaptive``, with what the nodes leave of the
    noise, see `classifier.samples.simulate_sums`.
    """
    layout = load_layout(Path("adaptive"))
    rng = np.random.default_rng(seed)
    sums = simulate_sums(true_force_n(meshes), layout, classified_phi(layout), NOISE_N, rng).astype(np.float32)
    gram, accuracies = sums @ sums.T, []
    for number in splits:
        split = draw_split(number, *SHARES, seed)
        chosen, X = trained(sums, split, gram)
        said = chosen.machine.predict(part_of(X, split.test, split.training, chosen.machine))
        accuracies.append(float(np.mean(said == LABELS[split.test])))
    return {"accuracy": accuracies, "sums": sums.shape[1]}
