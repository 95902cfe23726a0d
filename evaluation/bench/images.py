"""``skin bench images``: what each solver's images are worth, at the paper's speed of motion and ten times faster."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from evaluation.bench.scenes import make_scenes, mean_psnr, solved
from reconstructor.engine import Reconstructor
from reconstructor.settings import LIVE, PRESETS, SolverSettings
from skin.layout import load_layout
from skin.psnr import psnr_series_db
from skin.taxel import NOISE_N

SPEEDS: Final = (1, 10)


def run(meshes: Path | None = None) -> dict[str, Any]:
    """Return rows of method, object, speed and PSNR, dB, and their means over objects; `meshes` as in `make_scenes`."""
    phi = load_layout().phi()
    solvers: dict[str, tuple[SolverSettings, float | None]] = {name: (each, None) for name, each in PRESETS.items()}
    solvers["live, clip bias corrected"] = LIVE, NOISE_N
    rows: list[dict[str, Any]] = []
    for speed in SPEEDS:
        for scene in make_scenes(phi, speed, meshes):
            valid = np.ones(scene.sums.shape, np.bool_)
            shown = {"sensor": iter(scene.felt)} | {
                name: solved(Reconstructor(phi, 64, 64, settings, noise_n=noise_n), scene, valid)
                for name, (settings, noise_n) in solvers.items()
            }
            for method, images in shown.items():
                psnr_db = float(psnr_series_db(scene.true, images).mean())
                rows.append({"method": method, "object": scene.name, "speed": speed, "psnr_db": psnr_db})
    return {"rows": rows, "means": mean_psnr(rows, "method", "speed")}
