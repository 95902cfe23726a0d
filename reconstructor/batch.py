"""Recordings and several skins: many streams of sums at once on one processor."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from reconstructor.kernels.lanes import LANES, LaneSolver
from skin.errors import InputError

#: Frames solved ahead of each part, so that it starts as warm as if all before it had been solved.
RUN_IN: Final = 12


def reconstruct_recording(
    solver: LaneSolver, sums_n: npt.NDArray[np.floating[Any]], valid: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float32]:
    """Return the images of a recording, each warm-started from the one before.

    The recording is cut into as many parts as the solver has lanes; every part but the first begins `RUN_IN` frames
    early.

    Parameters
    ----------
    solver : LaneSolver
    sums_n, valid : arrays, shape (frames, m)
        Newtons, and which sums came.

    Returns
    -------
    array of float32, shape (frames, rows, columns)

    Raises
    ------
    InputError
        If the shapes do not fit, or a valid sum is not finite.
    """
    if sums_n.ndim != 2 or sums_n.shape[1] != solver.sums or valid.shape != sums_n.shape:
        raise InputError(f"expected shape (frames, {solver.sums}) twice: got {sums_n.shape} and {valid.shape}")
    if not np.isfinite(sums_n[valid]).all():
        raise InputError("a valid sum is not finite: expected newtons")
    frames = len(sums_n)
    if not frames:
        return np.empty((0, *solver.shape), np.float32)
    length = -(-frames // LANES)
    images = np.empty((frames, *solver.shape), np.float32)
    estimate = solver.new_estimate()
    starts = np.arange(LANES) * length
    for k in range(-RUN_IN, length):
        at = starts + k
        used = (at >= 0) & (at < frames)
        taken = np.clip(at, 0, frames - 1)
        weights = (valid[taken] & used[:, None]).astype(solver.dtype)
        sums = np.where(weights > 0, sums_n[taken], 0).astype(solver.dtype)
        solver.solve(estimate, sums, weights)
        if k >= 0:
            images[at[used]] = solver.deliver(estimate)[used]
    return images
