"""Images of a whole recording, by the fastest solver for the settings.

A solver of several streams divides the recording into parts of equal length, one per stream. Every part except the
first begins `RUN_IN` cycles early, so that its first image has a warm start.
"""

from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.array_api import BatchSolver
from reconstructor.checks import LARGEST_N
from reconstructor.engine import Reconstructor
from reconstructor.kernels.lanes import LANES, LaneSolver
from reconstructor.settings import COMPILED_WAVELETS, LIVE, SolverSettings
from skin.clipping import ClipCorrection
from skin.measurement import Sbhe

#: Cycles solved ahead of each part.
RUN_IN: Final = 12
#: Most streams on arrays: a part is still long compared with `RUN_IN`, and a batch fills a GPU.
ARRAY_STREAMS: Final = 256
#: Images between two calls of `advance`.
CHUNK: Final = 64
_LEAST_PART: Final = 4 * RUN_IN

Sums = npt.NDArray[np.floating[Any]]
Validity = npt.NDArray[np.bool_]
Images = npt.NDArray[np.float32]


def _silent(_images: int) -> None:
    pass


class RecordingSolver:
    """Solves whole recordings, each image warm-started from the one before.

    Haar and D4 use a `LaneSolver`, or with `library` a tensor basis uses a `BatchSolver`. All other priors and the
    temporal filter use the `Reconstructor`, one cycle after the other: the images equal those of the live service, bit
    by bit.

    Parameters
    ----------
    phi : Sbhe
    rows, columns : int
        The grid, powers of two from 8 to 256.
    settings : SolverSettings
    noise_n, samples
        See `Reconstructor`.
    library : module, optional
        A library of the Python array API, for example `reconstructor.array_api.gpu_library`.

    Attributes
    ----------
    method : str
        Text for the log: how the recording is solved.

    Raises
    ------
    InputError
        If the grid or the settings do not fit, or `library` has no solver for the settings.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        settings: SolverSettings = LIVE,
        *,
        noise_n: float | None = None,
        samples: int = 1,
        library: ModuleType | None = None,
    ) -> None:
        self._shape, self._sums = (rows, columns), phi.shape[0]
        self._correct = ClipCorrection(noise_n) if noise_n else None
        self._solve: Callable[[Sums, Validity, Images, Callable[[int], None]], None]
        if library is not None:
            self._arrays = BatchSolver(phi, rows, columns, settings, library=library)
            self._solve = self._on_arrays
            self.method = f"up to {ARRAY_STREAMS} parts of the recording side by side on arrays of {library.__name__}"
        elif settings.prior in COMPILED_WAVELETS and not settings.temporal_filter:
            self._lanes = LaneSolver(phi, rows, columns, settings)
            self._solve = self._in_lanes
            self.method = f"{LANES} parts of the recording side by side"
        else:
            self._engine = Reconstructor(phi, rows, columns, settings, samples=samples)
            self._solve = self._one_by_one
            self.method = "one image after the other"

    def solve(self, sums_n: Sums, valid: Validity, advance: Callable[[int], None] = _silent) -> Images:
        """Return the images of a recording; a cycle without any valid sum gives zeros.

        Parameters
        ----------
        sums_n : array, shape (cycles, m)
            Newtons; values of sums that are not valid have no effect.
        valid : array of bool, shape (cycles, m)
        advance : callable
            Called with the number of further images that are finished.

        Returns
        -------
        array of float32, shape (cycles, rows, columns)

        Raises
        ------
        InputError
            If shapes or dtypes do not fit, or a valid sum is not a number of newtons below 1e6.
        """
        if sums_n.ndim != 2 or sums_n.shape[1] != self._sums or valid.shape != sums_n.shape:
            raise InputError(f"expected shape (cycles, {self._sums}) twice: got {sums_n.shape} and {valid.shape}")
        if sums_n.dtype.kind != "f" or valid.dtype != np.bool_:
            raise InputError(f"expected floats and bools, got {sums_n.dtype} and {valid.dtype}")
        if not (np.abs(sums_n[valid]) <= LARGEST_N).all():  # NaN fails this form of the test
            raise InputError("a valid sum is not finite, or above 1e6: expected newtons")
        images = np.empty((len(sums_n), *self._shape), np.float32)
        self._solve(np.where(valid, sums_n, 0).astype(np.float32), valid, images, advance)
        if self._correct is not None:
            for image in images:  # not as one operation, to save memory
                image[:] = self._correct(image)
        return images

    def _one_by_one(self, sums: Sums, valid: Validity, images: Images, advance: Callable[[int], None]) -> None:
        self._engine.restart()
        for first in range(0, len(sums), CHUNK):
            chunk = range(first, min(first + CHUNK, len(sums)))
            for k in chunk:
                images[k] = self._engine.solve(sums[k], valid[k])
            advance(len(chunk))

    def _in_lanes(self, sums: Sums, valid: Validity, images: Images, advance: Callable[[int], None]) -> None:
        solver = self._lanes
        estimate = solver.new_estimate()
        for taken, used, is_kept in _turns(len(sums), LANES):
            weights = (valid[taken] & used[:, None]).astype(np.float32)
            estimate.reshape(-1, LANES)[:, ~weights.any(axis=1)] = 0
            solver.solve(estimate, sums[taken], weights)
            if is_kept:
                images[taken[used]] = solver.deliver(estimate)[used]
                advance(int(used.sum()))

    def _on_arrays(self, sums: Sums, valid: Validity, images: Images, advance: Callable[[int], None]) -> None:
        streams = max(1, min(ARRAY_STREAMS, len(sums) // _LEAST_PART))
        estimate = None
        for taken, used, is_kept in _turns(len(sums), streams):
            counted = valid[taken] & used[:, None]
            estimate = self._arrays.solve(sums[taken], counted, estimate)
            estimate = self._arrays.without(estimate, np.any(counted, axis=1))
            if is_kept:
                images[taken[used]] = self._arrays.deliver(estimate)[used]
                advance(int(used.sum()))


def _turns(cycles: int, streams: int) -> Iterator[tuple[npt.NDArray[np.intp], Validity, bool]]:
    """Yield for each turn the cycle of every stream, whether this cycle is in the recording, and if images are kept.

    A stream whose cycle is outside the recording gets another cycle; its image is not used.
    """
    length = -(-cycles // streams)
    starts = np.arange(streams) * length
    for turn in range(-RUN_IN if cycles and streams > 1 else 0, length):
        at = starts + turn
        used = (at >= 0) & (at < cycles)
        yield np.clip(at, 0, cycles - 1), used, turn >= 0
