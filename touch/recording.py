"""A recording of a sensor or of a program as a taxel source."""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.ranges import require_above_zero
from skin.sources import Frame
from skin.taxel import FORCE_MAX_N
from touch.contact import Force
from touch.reading import Counts

#: Largest force: far above any sensor, and within float32.
_LARGEST_FORCE_LOG10: Final = 30


class Recording:
    """Recorded frames in the middle of the skin; after the last frame the first follows.

    A `skin.sources.TaxelSource`. Labels are empty: a recording does not tell the touching object.

    Parameters
    ----------
    arrays : tuple of numpy.ndarray
        One array of shape (frames, rows, columns), or several arrays of equal rows, placed side by side; the shortest
        array determines the number of frames.
    rows, columns : int
        Taxels of the skin; the force around a smaller recording is 0.
    full_scale : float, optional
        The recorded value that becomes `force_max_n`; default: the largest value of the recording.
    force_max_n : float
        Force at full scale, newtons.
    steps_per_frame : float
        Number of SYNC cycles per recorded frame.

    Attributes
    ----------
    full_scale : float
        The full scale in use.
    frames : int
        Number of frames.
    shape : tuple of int
        Rows and columns of the recording, all arrays side by side.
    corner : tuple of int
        Row and column of the recording's first taxel on the skin.
    """

    has_noise = True

    def __init__(
        self,
        arrays: tuple[Counts, ...],
        rows: int,
        columns: int,
        *,
        full_scale: float | None = None,
        force_max_n: float = FORCE_MAX_N,
        steps_per_frame: float = 1.0,
    ) -> None:
        self._arrays = arrays
        self.frames = min(len(counts) for counts in arrays)
        require_above_zero("steps_per_frame", steps_per_frame)
        require_above_zero("force_max_n", force_max_n)
        self.steps_per_frame, self.force_max_n = steps_per_frame, force_max_n
        self.full_scale = _scale_of(arrays, full_scale, self.force_max_n)
        self._skin_shape = rows, columns
        self.shape = _shape(arrays)
        self.corner = _corner(self.shape, rows, columns)

    def frame(self, step: int) -> Frame:
        """Return the recorded touch at `step`, float32 (rows, columns) in newtons."""
        if step < 0:
            raise InputError(f"a source starts at step 0: got {step}")
        index = int(step / self.steps_per_frame) % self.frames
        force_n: Force = np.zeros(self._skin_shape, np.float32)
        row, column = self.corner
        for counts in self._arrays:
            high, wide = counts.shape[1:]
            force_n[row : row + high, column : column + wide] = self._newtons(counts[index])
            column += wide
        return Frame(force_n, "")

    @property
    def rest_n(self) -> float:
        """Force at which most taxels are most of the time, newtons; 0 where no such rest stands out."""
        low, middle = np.quantile(np.concatenate([each.ravel() for each in self._arrays]), (0.25, 0.5))
        return float(self._newtons(middle)) if low > 0.75 * middle else 0.0

    def _newtons(self, counts: Counts) -> npt.NDArray[np.float64]:
        return counts.astype(np.float64) / self.full_scale * self.force_max_n


def _scale_of(arrays: tuple[Counts, ...], full_scale: float | None, force_max_n: float) -> float:
    largest = max(float(counts.max()) for counts in arrays)
    if full_scale is None and largest == 0.0:
        raise InputError("the recording holds only zeros: give the value of the largest force with --full-scale")
    scale = float(largest if full_scale is None else full_scale)
    require_above_zero("the full scale (--full-scale)", scale)
    # Comparing logarithms, because the quotient itself may overflow.
    if largest > 0.0 and math.log10(largest) - math.log10(scale) + math.log10(force_max_n) > _LARGEST_FORCE_LOG10:
        raise InputError(f"a full scale (--full-scale) of {scale} is too small for a recording that reaches {largest}")
    return scale


def _shape(arrays: tuple[Counts, ...]) -> tuple[int, int]:
    heights = {counts.shape[1] for counts in arrays}
    if len(heights) != 1:
        raise InputError(f"arrays side by side need as many rows each: got {sorted(heights)}")
    return heights.pop(), sum(counts.shape[2] for counts in arrays)


def _corner(shape: tuple[int, int], rows: int, columns: int) -> tuple[int, int]:
    high, wide = shape
    if high > rows or wide > columns:
        raise InputError(
            f"a recording of {high} x {wide} taxels does not fit a skin of {rows} x {columns}: "
            f"give a larger skin with --layout"
        )
    return (rows - high) // 2, (columns - wide) // 2
