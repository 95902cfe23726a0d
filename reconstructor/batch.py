"""Recordings: every frame of a stream of sums that is there as a whole."""

from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from reconstructor.checks import LARGEST_N
from reconstructor.kernels.lanes import LANES, LaneSolver
from skin.errors import InputError

#: Frames solved ahead of each part, so that it starts as warm as if all before it had been solved.
RUN_IN: Final = 12

Values = npt.NDArray[np.floating[Any]]


class ImageSolver(Protocol):
    """`FusedSolver` or `ContourletSolver`: one image after the other."""

    @property
    def sums(self) -> int:
        """Number of sums m."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the images."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of sums and estimates."""
        ...

    def new_estimate(self) -> Values:
        """Return an estimate of zeros."""
        ...

    def reset(self) -> None:
        """Forget what is kept besides the estimate."""
        ...

    def solve(self, estimate: Values, sums_n: Values, weights: Values) -> int:
        """Improve the estimate in place."""
        ...

    def deliver(self, estimate: Values) -> npt.NDArray[np.float32]:
        """Return the image."""
        ...


def reconstruct_recording(
    solver: LaneSolver | ImageSolver, sums_n: Values, valid: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float32]:
    """Return the images of a recording, each warm-started from the one before.

    A `LaneSolver`, which there is for wavelets, cuts the recording into as many parts as it has lanes; every part but
    the first begins `RUN_IN` frames early. Any other solver takes one frame after the other.

    Parameters
    ----------
    solver : LaneSolver, FusedSolver or ContourletSolver
    sums_n, valid : arrays, shape (frames, m)
        Newtons, and which sums came.

    Returns
    -------
    array of float32, shape (frames, rows, columns)

    Raises
    ------
    InputError
        If shapes or dtypes do not fit, or a valid sum is not a number of newtons below 1e6.
    """
    if sums_n.ndim != 2 or sums_n.shape[1] != solver.sums or valid.shape != sums_n.shape:
        raise InputError(f"expected shape (frames, {solver.sums}) twice: got {sums_n.shape} and {valid.shape}")
    if sums_n.dtype.kind != "f" or valid.dtype != np.bool_:
        raise InputError(f"expected floats and bools, got {sums_n.dtype} and {valid.dtype}")
    if not (np.abs(sums_n[valid]) <= LARGEST_N).all():  # so written, NaN fails
        raise InputError("a valid sum is not finite, or above 1e6: expected newtons")
    clean = np.where(valid, sums_n, 0).astype(solver.dtype)
    if isinstance(solver, LaneSolver):
        return _in_lanes(solver, clean, valid)
    return _one_by_one(solver, clean, valid)


def _one_by_one(solver: ImageSolver, sums: Values, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    images = np.empty((len(sums), *solver.shape), np.float32)
    estimate, weights = solver.new_estimate(), valid.astype(solver.dtype)
    solver.reset()
    for k, each in enumerate(sums):
        solver.solve(estimate, each, weights[k])
        images[k] = solver.deliver(estimate)
    return images


def _in_lanes(solver: LaneSolver, sums: Values, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    frames = len(sums)
    images = np.empty((frames, *solver.shape), np.float32)
    length = -(-frames // LANES)
    estimate = solver.new_estimate()
    starts = np.arange(LANES) * length
    for k in range(-RUN_IN if frames else 0, length):
        at = starts + k
        used = (at >= 0) & (at < frames)
        taken = np.clip(at, 0, frames - 1)
        weights = (valid[taken] & used[:, None]).astype(solver.dtype)
        solver.solve(estimate, sums[taken], weights)
        if k >= 0:
            images[at[used]] = solver.deliver(estimate)[used]
    return images
