"""What the image benchmarks look at: the paper's five objects on its trajectory, with the paper's noise."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evaluation.result import Row, grouped
from reconstructor.engine import Reconstructor
from skin.measurement import Sbhe
from skin.taxel import sense
from touch.contact import Force
from touch.trajectory import ACQUISITION_OBJECTS, trajectory


@dataclass(frozen=True, eq=False)
class Scene:
    """True and felt forces, newtons, shape (frames, rows, columns), and their sums, shape (frames, m)."""

    name: str
    true: Force
    felt: Force
    sums: npt.NDArray[np.float32]


def make_scenes(phi: Sbhe, speed: int, meshes: Path | None = None) -> Iterator[Scene]:
    """Yield every scene at `speed` times the paper's 0.045 mm a cycle: one in `speed` of the paper's 4200 steps.

    `phi` is of the 64 x 64 array; `meshes` as in `touch.objects.spheres_of`.
    """
    random = np.random.default_rng(11)
    for name in ACQUISITION_OBJECTS:
        true = trajectory(name, meshes=meshes, speed=speed)
        felt = sense(true, random)
        yield Scene(name, true, felt, np.asarray(phi.forward(felt.reshape(len(felt), -1)), np.float32))


def solved(engine: Reconstructor, scene: Scene, valid: npt.NDArray[np.bool_]) -> Iterator[Force]:
    """Yield the image of every frame; `valid` of shape (frames, m)."""
    for sums_n, present in zip(scene.sums, valid, strict=True):
        yield engine.solve(sums_n, present)


def mean_psnr(rows: list[Row], *keys: str) -> list[Row]:
    """Return one row for each combination of `keys`, in order of appearance, with the mean of ``psnr_db``."""
    return [
        {**dict(zip(keys, group, strict=True)), "psnr_db": float(np.mean([row["psnr_db"] for row in found]))}
        for group, found in grouped(rows, *keys).items()
    ]
