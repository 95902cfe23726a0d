"""Images of a real pressure mat: less noise than the simulated sensor, and no true signal but the recorded one."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from reconstructor.engine import Reconstructor
from reconstructor.settings import LIVE, PAPER, SolverSettings
from skin.phi import Sbhe
from tests.reconstructor.helpers import FORCE_MAX_N, psnr_db

POSTURES = (1, 9, 13, 17)


def mats(posture: int) -> np.ndarray:
    """Two people's recordings side by side, 64 x 64, full scale at 0.02 N."""
    folder = Path(os.environ["SKIN_DATA"], "pressure-mat")
    halves = []
    for name in ("S1", "S2"):
        with np.load(folder / f"{name}.npz") as recording:
            halves.append(recording[f"posture_{posture:02d}"].astype(np.float32))
    frames = min(map(len, halves))
    return np.concatenate([half[:frames] for half in halves], axis=2) * np.float32(FORCE_MAX_N / 4095)


def quality_db(phi: Sbhe, true: np.ndarray, settings: SolverSettings) -> float:
    engine, valid = Reconstructor(phi, 64, 64, settings), np.ones(1024, np.bool_)
    sums = np.asarray(phi.forward(true.reshape(len(true), -1)), np.float32)
    return float(psnr_db(np.stack([engine.solve(each, valid) for each in sums]), true).mean())


@pytest.mark.slow
def test_recordings_gain_over_plain_haar_at_its_best(phi: Sbhe) -> None:
    if "SKIN_DATA" not in os.environ:
        pytest.skip("NOT TESTED: images of real recordings, for want of SKIN_DATA")
    live, haar = [], []
    for posture in POSTURES:
        true = mats(posture)
        live.append(quality_db(phi, true, LIVE))
        plain = replace(PAPER, prior="haar-pyramid", lipschitz_ratio=1.0)
        haar.append(max(quality_db(phi, true, replace(plain, penalty_n=each)) for each in (1e-4, 3e-4, 1e-3, 3e-3)))
    assert np.mean(live) > np.mean(haar) + 2
