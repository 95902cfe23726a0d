"""The newest cycles of a skin as arrays and as one image."""

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.frame import Frame

#: Of the image: the largest value, and that of a taxel that was not measured, in the third channel.
FULL: Final = 255
#: Prefix of the features of a data set.
PREFIX: Final = "observation.skin"


@dataclass(frozen=True, eq=False)
class TouchWindow:
    """The newest cycles of a skin, the oldest first.

    A cycle whose frame did not come has its place: force 0, not valid, no time. A skin that is no grid has one row, so
    its image has a line for each cycle.

    Attributes
    ----------
    force_n : array of float32, shape (window, rows, columns)
        Newtons; the solver's estimate from the neighbours where not `valid`.
    valid : array of bool, shape (window, rows, columns)
        True where the taxel's block was measured.
    cycle : array of int64, shape (window,)
        Number of each cycle.
    sampled_ns : array of int64, shape (window,)
        Wall clock at which the boards sampled, Unix time in nanoseconds; 0 if unknown.
    age_s : array of float32, shape (window,)
        Seconds from sampling to the reading of this window; -1 if unknown.
    """

    force_n: npt.NDArray[np.float32]
    valid: npt.NDArray[np.bool_]
    cycle: npt.NDArray[np.int64]
    sampled_ns: npt.NDArray[np.int64]
    age_s: npt.NDArray[np.float32]

    def image(self, force_max_n: float) -> npt.NDArray[np.uint8]:
        """Return the window as one image, shape (window · rows, columns, 3), the oldest frame on top.

        Red: force of measured taxels, 255 = `force_max_n`; 0 where not measured. Green: as red, with the solver's
        estimate where not measured. Blue: 255 where not measured, else 0.
        """
        level = np.rint(np.clip(self.force_n / force_max_n, 0.0, 1.0) * FULL).astype(np.uint8)
        image = np.empty((*level.shape, 3), np.uint8)
        image[..., 0] = np.where(self.valid, level, 0)
        image[..., 1] = level
        image[..., 2] = np.where(self.valid, 0, FULL)
        return image.reshape(-1, level.shape[2], 3)

    def observation(self, prefix: str = PREFIX) -> dict[str, npt.NDArray[Any]]:
        """Return what a frame of a LeRobot data set with these `features` holds."""
        return {
            f"{prefix}.force": self.force_n,
            f"{prefix}.valid": self.valid,
            f"{prefix}.cycle": self.cycle,
            f"{prefix}.sampled_ns": self.sampled_ns,
            f"{prefix}.age": self.age_s,
        }


def features(window: int, rows: int, columns: int, prefix: str = PREFIX) -> dict[str, dict[str, Any]]:
    """Return the features of a LeRobot data set that hold a `TouchWindow` without loss, see its attributes."""
    pixels = {"shape": (window, rows, columns), "names": ["frame", "row", "column"]}
    times = {"shape": (window,), "names": None}
    return {
        f"{prefix}.force": {"dtype": "float32", **pixels},
        f"{prefix}.valid": {"dtype": "bool", **pixels},
        f"{prefix}.cycle": {"dtype": "int64", **times},
        f"{prefix}.sampled_ns": {"dtype": "int64", **times},
        f"{prefix}.age": {"dtype": "float32", **times},
    }


def forces(
    image: npt.ArrayLike, window: int, force_max_n: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Return force and validity of an image, each of shape (window, rows, columns), as `TouchWindow` has them.

    Parameters
    ----------
    image : array of uint8, shape (window · rows, columns, 3), or of float, shape (3, window · rows, columns)
        As the camera returned it, or with values 0 to 1 as a LeRobot data set returns it.
    force_max_n : float
        As in the camera's configuration.

    Raises
    ------
    ValueError
        If the image has another shape.
    """
    levels = np.asarray(image)
    if levels.dtype != np.uint8:
        levels = np.rint(np.moveaxis(levels, 0, -1) * FULL) if levels.ndim == 3 else levels
    if levels.ndim != 3 or levels.shape[2] != 3 or levels.shape[0] % window:
        raise ValueError(
            f"expected an image of {window} frames, uint8 (height, width, 3) or float (3, height, width), got"
            f" {np.shape(image)}"
        )
    stack = levels.reshape(window, -1, levels.shape[1], 3)
    return (stack[..., 1] * (force_max_n / FULL)).astype(np.float32), stack[..., 2] < FULL / 2


class WindowBuffer:
    """The newest frames of a skin, for a reader in another thread.

    Attributes
    ----------
    count, used : int
        Number of frames that came, and that had come when the last window was read.
    lost : int
        Cycles since the first window that were in no window: their frames did not come, or were too old when the next
        window was read.
    """

    def __init__(self, window: int, rows: int, columns: int) -> None:
        self.count = 0
        self.used = 0
        self.lost = 0
        self._shape = (window, rows, columns)
        self._frames: deque[Frame] = deque(maxlen=window)
        self._changed = threading.Condition()
        self._read_cycle: int | None = None

    @property
    def age_s(self) -> float | None:
        """Age of the newest frame; None before the first."""
        with self._changed:
            return self._frames[-1].age if self._frames else None

    def put(self, frame: Frame) -> None:
        """Add a frame; if the gateway has started anew, which numbers cycles from 1, begin a new window."""
        with self._changed:
            if self._frames and frame.cycle <= self._frames[-1].cycle:
                self._frames.clear()
                self._read_cycle = None
            self._frames.append(frame)
            self.count += 1
            self._changed.notify_all()

    def wait_for(self, count: int, timeout_s: float, max_age_s: float) -> bool:
        """Wait until `count` frames came and the newest is at most so old; tell whether that was in time."""
        give_up_s = time.monotonic() + timeout_s
        with self._changed:
            while self.count < count or not self._is_young(max_age_s):
                if not self._changed.wait(max(0.0, give_up_s - time.monotonic())):
                    return False
            return True

    def read(self, max_age_s: float) -> TouchWindow | None:
        """Return the window that ends with the newest frame; None if there is none so young."""
        with self._changed:
            if not self._is_young(max_age_s):
                return None
            frames, newest = list(self._frames), self._frames[-1].cycle
            window, rows, columns = self._shape
            cycle = np.arange(newest - window + 1, newest + 1, dtype=np.int64)
            places = [(frame.cycle - int(cycle[0]), frame) for frame in frames if frame.cycle >= cycle[0]]
            if self._read_cycle is not None:
                new = newest - self._read_cycle
                self.lost += new - sum(frame.cycle > self._read_cycle for _place, frame in places)
            self._read_cycle, self.used = newest, self.count
        force_n = np.zeros((window, rows, columns), np.float32)
        valid = np.zeros((window, rows, columns), np.bool_)
        sampled_ns = np.zeros(window, np.int64)
        age_s = np.full(window, -1.0, np.float32)
        for place, frame in places:
            force_n[place], valid[place] = frame.estimate, frame.valid
            age_s[place] = frame.age
            if np.isfinite(frame.sampled_at):
                sampled_ns[place] = round(frame.sampled_at * 1e9)
        return TouchWindow(force_n, valid, cycle, sampled_ns, age_s)

    def _is_young(self, max_age_s: float) -> bool:
        return bool(self._frames) and self._frames[-1].age <= max_age_s  # NaN is old
