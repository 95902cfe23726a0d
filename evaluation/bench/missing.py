"""``skin bench missing``: images with dead nodes, and with frames that random loss takes from the bus."""

from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.bench.scenes import make_scenes, mean_psnr, solved
from evaluation.result import new_figure
from reconstructor.engine import Reconstructor
from reconstructor.settings import preset
from shell.output import save_figure
from skin.layout import load_layout
from skin.measurement import Sbhe
from skin.psnr import psnr_series_db

METHODS: Final = ("live", "variation", "spun", "paper")
#: Of 128, drawn at random and the same for every method.
DEAD_NODES: Final = (0, 1, 2, 4, 8, 16, 32)
LOSS_RATIOS: Final = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3)
#: A node's eight sums travel in two frames, and count only if both come.
FRAMES_PER_BLOCK: Final = 2
#: At 100 cycles a second the paper's motion, of 1 kHz, is ten times as far from cycle to cycle.
SPEED: Final = 10

Validity = npt.NDArray[np.bool_]


def run(rounds: int) -> dict[str, Any]:
    """Return the curves as rows of method, kind, amount and PSNR over `rounds` draws of what is missing."""
    phi = load_layout().phi()
    rows: list[dict[str, Any]] = []
    missing = [("dead_nodes", amount) for amount in DEAD_NODES] + [("loss_ratio", amount) for amount in LOSS_RATIOS]
    for scene, (kind, amount) in product(make_scenes(phi, SPEED), missing):
        for draw, method in product(range(rounds if amount else 1), METHODS):
            blocks = _present(phi, kind, amount, len(scene.sums), seed=draw)
            images = solved(Reconstructor(phi, 64, 64, preset(method)), scene, blocks[:, phi.block_of_sum])
            psnr_db = float(psnr_series_db(scene.true, images).mean())
            rows.append({"method": method, "kind": kind, "amount": amount, "psnr_db": psnr_db})
    return {"rows": mean_psnr(rows, "method", "kind", "amount")}


def _present(phi: Sbhe, kind: str, amount: float, frames: int, seed: int) -> Validity:
    """Return which blocks' sums come in each cycle, shape (frames, blocks)."""
    random = np.random.default_rng(seed)
    if kind == "dead_nodes":
        alive = np.ones(phi.blocks, np.bool_)
        alive[random.permutation(phi.blocks)[: int(amount)]] = False
        return np.tile(alive, (frames, 1))
    return np.asarray((random.random((frames, phi.blocks, FRAMES_PER_BLOCK)) >= amount).all(axis=2))


def draw(result: dict[str, Any], path: Path) -> None:
    """Write both curves as a figure, the format by the ending of `path`."""
    figure = new_figure(9, 3.6)
    for place, (kind, label) in enumerate((("dead_nodes", "dead nodes of 128"), ("loss_ratio", "frames lost, %"))):
        axes = figure.add_subplot(1, 2, place + 1)
        for method in METHODS:
            points = [
                (row["amount"], row["psnr_db"])
                for row in result["rows"]
                if (row["kind"], row["method"]) == (kind, method)
            ]
            amounts, values = zip(*points, strict=True)
            scale = 100 if kind == "loss_ratio" else 1
            axes.plot([scale * amount for amount in amounts], values, marker="o", label=method)
        axes.set_xlabel(label)
        axes.set_ylabel("PSNR, dB")
        axes.grid(alpha=0.3)
        axes.legend()
    save_figure(figure, path)
