"""A touch as a scheme meets it: what happens, how noisy the sensor is, and what the buses lose."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evaluation.schemes.scenes import Scene, scene
from skin.taxel import NOISE_N


@dataclass(frozen=True)
class Touch:
    """A scene and what is wrong with it, see `evaluation.schemes.scenes.scene`.

    Attributes
    ----------
    name : str
        Of a slide or an own touch, or the path of a recording.
    ticks : int, optional
        Only the first so many milliseconds; without it, all of the scene.
    noise_n : float
        Standard deviation of the sensor's noise, newtons.
    loss_ratio : float
        Part of all frames that never reach the receiver, 0 to 1.
    meshes : str, optional
        Folder of meshes that take the place of the shapes that ship.
    seed : int
        Of noise and losses.
    """

    name: str
    ticks: int | None = None
    noise_n: float = NOISE_N
    loss_ratio: float = 0.0
    meshes: str | None = None
    seed: int = 0

    @property
    def words(self) -> str:
        """What it is called in a table."""
        name = f"recording {Path(self.name).stem}" if self.name.endswith(".npz") else self.name
        noise = f", noise {1e3 * self.noise_n:g} mN" if self.noise_n != NOISE_N else ""
        return name + noise + (f", {self.loss_ratio:.0%} of frames lost" if self.loss_ratio else "")

    @property
    def is_plain(self) -> bool:
        """Whether noise is the paper's and nothing is lost."""
        return self.noise_n == NOISE_N and not self.loss_ratio

    def arrives(self, frames: int) -> npt.NDArray[np.bool_]:
        """Draw which of so many frames reach the receiver."""
        return np.random.default_rng(self.seed).random(frames) >= self.loss_ratio

    def load(self) -> Scene:
        """Return the scene itself."""
        meshes = Path(self.meshes) if self.meshes else None
        return scene(self.name, ticks=self.ticks, noise_n=self.noise_n, meshes=meshes, seed=self.seed)
