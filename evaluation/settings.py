"""``skin evaluate paper settings``: settings that the paper prints, and figures of the default skin's cycles."""

import math
from pathlib import Path
from typing import Final

import numpy as np

from bandwidth.plan import plan
from dbc.contract import Contract
from dbc.dictionary import window_s
from evaluation.observations import LABELS, OBJECTS, TAXELS, draw_split
from evaluation.paper.pictures import SCALE_N
from evaluation.paper.runs import NOISELET_PENALTY_N
from evaluation.paper.sparsity import THRESHOLD_N
from evaluation.printed import paper_value
from evaluation.recognition.accuracy import FULL, TRAINING
from evaluation.recognition.classification import CONFUSION_SIZE, SPLITS
from evaluation.result import Options, Result, beside
from evaluation.schemes.scenes import SLIDE_TICKS, SLIDES, Touch
from evaluation.schemes.sums import run_sums
from reconstructor.bases.contourlet import LEVELS
from reconstructor.settings import PAPER
from skin.layout import load_layout
from skin.phi import sbhe
from skin.taxel import FORCE_MAX_N, NOISE_N
from touch.classification_poses import OFFSETS_M, PERTURBATIONS, ROTATIONS_RAD
from touch.coarse_arrays import ARRAYS, SIDE_M
from touch.trajectory import PAPER_STEP_S, PAPER_STEPS

_SPLIT: Final = draw_split(0, *FULL)
#: Milliseconds of the slide for a quick look.
QUICK_TICKS: Final = 400
#: Ours, by the name of the setting in ``printed.toml``.
SETTINGS: Final[dict[str, float]] = {
    "taxels": TAXELS,
    "objects": OBJECTS,
    "side of the array, mm": 1e3 * SIDE_M,
    "steps of a trajectory": PAPER_STEPS,
    "frequency of the steps, Hz": 1 / PAPER_STEP_S,
    "deviation of the noise, N": NOISE_N,
    "largest force of a taxel, N": FORCE_MAX_N,
    "end of the colour scale, N": SCALE_N,
    "perturbations": PERTURBATIONS,
    "observations": len(LABELS),
    "offsets along rows and along columns": len(OFFSETS_M),
    "largest offset, mm": 1e3 * max(OFFSETS_M),
    "rotations": len(ROTATIONS_RAD),
    "largest rotation, degrees": math.degrees(max(ROTATIONS_RAD)),
    "arrays": len(ARRAYS),
    "threshold of Table I, N": THRESHOLD_N,
    "taxels of a group of an SBHE": sbhe(TAXELS, TAXELS).block_size,
    "L / largest eigenvalue": PAPER.lipschitz_ratio,
    "λ for SBHE, N": PAPER.penalty_n,
    "λ for noiselets, N": NOISELET_PENALTY_N,
    "exponent of the contourlet's directions": LEVELS,
    "observations of the development set": len(_SPLIT.development),
    "observations of the validation set": len(_SPLIT.validation),
    "observations of the test set": len(_SPLIT.test),
    "splits": SPLITS,
    **{f"development set {number} of 6, %": 100 * share for number, (share, _) in enumerate(TRAINING, 1)},
    "validation set of the largest development set, %": 100 * FULL[1],
    "validation set of the smallest development set, %": 100 * TRAINING[-1][1],
    "sums of the confusions": CONFUSION_SIZE,
}


def evaluate(options: Options) -> Result:
    """Return a row for each setting, and for each figure of the default skin."""
    ours_of = SETTINGS | cycle_figures(QUICK_TICKS if options.quick else SLIDE_TICKS, **options.shared)
    rows = [
        {"setting": name} | beside(ours, paper_value("settings", setting=name), digits=6)
        for name, ours in ours_of.items()
    ]
    return Result("Settings that the paper prints", rows)


def cycle_figures(ticks: int, *, meshes: str | None, seed: int) -> dict[str, float]:
    """Return what the paper says of a cycle: sums, conversions, and how often all sums come, a second.

    Cycles are complete if every frame comes in the window, on simulated buses, while an object slides for `ticks`.
    """
    layout, analogue = load_layout(), load_layout(Path("analogue"))
    contract, touch = Contract.from_layout(layout), Touch(SLIDES[0], ticks=ticks, meshes=meshes, seed=seed)
    run = run_sums(contract, touch.load().counts, touch.idle())
    late_ns = run.latency_ns.reshape(len(run.sums_n), -1).max(axis=1)
    # In turns the first measurements lack the sums of the others.
    is_complete = (late_ns <= 1e9 * window_s(layout))[layout.sync.turns - 1 :]
    carried_hz = min(bus.max_rate_hz_random for bus in plan(contract))
    return {
        "taxels / sums": layout.taxels.count / layout.measurement.sums,
        "conversions of taxels / of sums": analogue.taxels.count / analogue.measurement.sums,
        "complete cycles a second": float(np.mean(is_complete)) * layout.sync.rate_hz / layout.sync.turns,
        "cycles a second of four buses": carried_hz / layout.sync.turns,
    }
