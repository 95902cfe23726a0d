"""What the image benchmarks look at: objects of the catalogue on the paper's trajectory, with the paper's noise."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.bench.problem import FORCE_MAX_N, NOISE_N
from reconstructor.engine import Reconstructor
from skin.measurement import Sbhe
from touch.contact import Grid, press
from touch.objects import spheres_of
from touch.trajectory import PAPER_STEPS, paper_pose

Images = npt.NDArray[np.float32]
#: Objects and where they start, metres, and how they are turned, radians; the golf ball's start is the paper's.
SCENES: Final = {
    "golf-ball": ((0.06, 0.06), 0.0),
    "granola-box": ((0.02, 0.0), np.pi),
    "ring": ((0.05, 0.05), 0.0),
    "cracker-box": ((0.03, 0.02), 0.4),
}


@dataclass(frozen=True, eq=False)
class Scene:
    """True and felt forces, newtons, shape (frames, rows, columns), and their sums, shape (frames, m)."""

    name: str
    true: Images
    felt: Images
    sums: npt.NDArray[np.float32]


def make_scenes(phi: Sbhe, speed: int, seed: int = 11) -> Iterator[Scene]:
    """Return every scene at `speed` times the paper's 0.045 mm a cycle."""
    random = np.random.default_rng(seed)
    for name, (start_m, rotation_rad) in SCENES.items():
        steps = range(0, PAPER_STEPS, speed)
        spheres = spheres_of(name)
        true = np.stack([press(Grid(), [(spheres, paper_pose(step, start_m, rotation_rad))]) for step in steps])
        noise = random.standard_normal(true.shape, np.float32) * np.float32(NOISE_N)
        felt = np.clip(true + noise, 0, np.float32(FORCE_MAX_N))
        yield Scene(name, true, felt, np.asarray(phi.forward(felt.reshape(len(felt), -1)), np.float32))


def solved(engine: Reconstructor, scene: Scene, valid: npt.NDArray[np.bool_]) -> Iterator[Images]:
    """Yield the image of every frame; `valid` of shape (frames, m)."""
    for sums_n, present in zip(scene.sums, valid, strict=True):
        yield engine.solve(sums_n, present)


def mean_psnr_db(images: Iterable[Images], scene: Scene) -> float:
    """Return the mean over frames of the PSNR, peak 0.02 N (section V of the paper)."""
    pairs = zip(images, scene.true, strict=True)
    errors = [float(np.mean((image.astype(np.float64) - true) ** 2)) for image, true in pairs]
    return float(np.mean(10 * np.log10(FORCE_MAX_N**2 / np.maximum(errors, 1e-16))))


def mean_over(rows: list[dict[str, Any]], value: str, *keys: str) -> list[dict[str, Any]]:
    """Return one row for each combination of `keys`, in order of appearance, with the mean of `value`."""
    groups: dict[tuple[Any, ...], list[float]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row[value])
    return [{**dict(zip(keys, group, strict=True)), value: float(np.mean(values))} for group, values in groups.items()]
