"""FISTA on whole recordings with any library of the Python array API: NumPy, or CuPy on a GPU.

Every step is a matrix product or an elementwise operation on (frames, …) arrays; wavelets and Hadamard blocks are
applied as small dense matrices, which are faster on a GPU than butterflies. A recording is divided into parts of equal
length, which are solved side by side. Every part except the first begins `RUN_IN` cycles early, so that its first image
has a warm start.
"""

from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.bases import wavelet_basis
from reconstructor.checks import LARGEST_N, check_grid_of, float_kind
from reconstructor.fista import momentum
from reconstructor.settings import SolverSettings
from shell.extras import not_installed
from skin.clipping import ClipCorrection
from skin.measurement import Sbhe, fast_hadamard

#: Cycles solved ahead of each part.
RUN_IN: Final = 12
#: Most parts: a part is still long compared with `RUN_IN`, and a batch fills a GPU.
PARTS: Final = 256
_LEAST_PART: Final = 4 * RUN_IN

Bools = npt.NDArray[np.bool_]


def gpu_library() -> ModuleType:
    """Return CuPy; raise InputError if CuPy is not installed or finds no GPU."""
    try:
        import cupy
    except ImportError as error:
        raise not_installed(f"CuPy cannot be loaded ({error})", "gpu") from error
    try:
        cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise InputError(f"CuPy finds no GPU: {error}") from error
    return cupy  # type: ignore[no-any-return]  # cupy has no types


class BatchSolver:
    """min ½‖Φx_f - y_f‖² + λ‖Ψᵀx_f‖₁ for all frames f at once, Ψ a tensor basis: the paper's solver for recordings.

    Parameters
    ----------
    rows, columns : int
        Powers of two, 8 to 256.
    settings : SolverSettings
        With a prior of the form "tensor", without spins, scaled start and temporal filter.
    library : module
        NumPy, CuPy or another library of the array API.
    noise_n : float, optional
        See `reconstructor.engine.Reconstructor`.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        settings: SolverSettings,
        *,
        library: ModuleType = np,
        noise_n: float | None = None,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        check_grid_of(phi, rows, columns, settings.prior)
        is_tensor = settings.prior.endswith("-tensor")
        if not is_tensor or settings.spins > 1 or settings.scaled_start or settings.temporal_filter:
            raise InputError(
                "a GPU needs a prior of the form 'tensor' without spins, scaled start and temporal filter, "
                f"as the solver 'paper' has them: got {settings}"
            )
        self._xp: Final = library
        self._correct = ClipCorrection(noise_n) if noise_n else None
        self._kind = getattr(library, float_kind(dtype).name)
        self._grid, self._blocks = (rows, columns), (phi.blocks, phi.block_size)
        self._step = 1 / (settings.lipschitz_ratio * phi.block_size)
        self._threshold = settings.penalty_n * self._step
        self._nonnegative = settings.nonnegative
        self._momentum = [float(weight) for weight in momentum(settings.iterations)]
        self._down, self._across = map(self._send, wavelet_basis(settings.prior, rows, columns).steps[0])
        self._hadamard = self._send(fast_hadamard(np.eye(phi.block_size)))
        self._order = library.asarray(phi.order)
        self._place = library.asarray(np.argsort(phi.order))
        self._spot = library.asarray(np.flatnonzero(phi.kept.reshape(-1)))
        self._slot = library.asarray(np.maximum(np.cumsum(phi.kept.reshape(-1)) - 1, 0))
        self._kept = self._send(phi.kept.reshape(-1))

    def solve_recording(
        self, sums_n: npt.NDArray[np.floating[Any]], valid: Bools, advance: Callable[[int], None]
    ) -> npt.NDArray[np.float32]:
        """Return the images of a recording, newtons, shape (cycles, rows, columns); without a valid sum they are zero.

        Parameters
        ----------
        sums_n : array, shape (cycles, m)
            Newtons; values of sums that are not valid have no effect.
        valid : array of bool, shape (cycles, m)
        advance : callable
            Called with the number of further images that are finished.
        """
        images = np.empty((len(sums_n), *self._grid), np.float32)
        estimate = None
        for taken, used, is_kept in _turns(len(sums_n), max(1, min(PARTS, len(sums_n) // _LEAST_PART))):
            counted = valid[taken] & used[:, None]
            estimate = self.solve(sums_n[taken], counted, estimate)
            estimate = self._without(estimate, np.any(counted, axis=1))
            if is_kept:
                images[taken[used]] = self.deliver(estimate)[used]
                advance(int(used.sum()))
        return images

    def solve(self, sums_n: Any, valid: Any, start: Any = None) -> Any:
        """Return estimates, shape (frames, rows, columns), as an array of the library; `deliver` returns images.

        Parameters
        ----------
        sums_n : array, shape (frames, m)
            Newtons; an array that the library can convert.
        valid : array of bool, shape (frames, m)
            Sums that are not valid have no effect.
        start : array, shape (frames, rows, columns), optional
            Estimates to start from, zeros without.
        """
        mask, target = self._load(sums_n, valid)
        ahead = estimate = self._begin(start, mask.shape[0])
        for weight in self._momentum:
            previous = estimate
            estimate = self._shrink(ahead - self._slope(ahead, mask, target))
            ahead = estimate + weight * (estimate - previous)
        return estimate

    def _without(self, estimate: Any, kept: Bools) -> Any:
        """Return the estimates, with zeros in frames that are not `kept`, shape (frames,)."""
        mask = self._xp.reshape(self._xp.asarray(kept), (-1, 1, 1))
        return self._xp.where(mask, estimate, self._xp.zeros_like(estimate))

    def deliver(self, estimate: Any) -> npt.NDArray[np.float32]:
        """Return estimates as NumPy images, shape (frames, rows, columns), negative forces as 0."""
        if hasattr(estimate, "get"):  # CuPy copies from the GPU only by `get`
            estimate = estimate.get()
        images: npt.NDArray[np.float32] = np.maximum(np.asarray(estimate), 0).astype(np.float32)
        return images if self._correct is None else self._correct(images)

    def _send(self, values: npt.NDArray[Any]) -> Any:
        return self._xp.asarray(values, dtype=self._kind)

    def _begin(self, start: Any, frames: int) -> Any:
        """Return the images to start from."""
        xp, shape = self._xp, (frames, *self._grid)
        if start is None:
            return xp.zeros(shape, dtype=self._kind)
        images = xp.asarray(start, dtype=self._kind)
        if images.shape != shape or not bool(xp.all(xp.isfinite(images))):
            raise InputError(f"expected a start of finite newtons of shape {shape}: got {images.shape}")
        return images

    def _load(self, sums_n: Any, valid: Any) -> tuple[Any, Any]:
        """Return mask and masked sums over all Hadamard rows, both times 1 / L, shape (frames, n)."""
        xp = self._xp
        sums, told = xp.asarray(sums_n), xp.asarray(valid)
        count = self._spot.shape[0]
        if sums.ndim != 2 or sums.shape[1] != count or told.shape != sums.shape:
            raise InputError(f"expected sums and validity of shape (frames, {count}): got {sums.shape}, {told.shape}")
        # Compared in a tuple: NumPy's dtypes equal float32 and so on, but have another hash.
        if sums.dtype not in (xp.float32, xp.float64) or told.dtype != xp.asarray(True).dtype:
            raise InputError(f"expected floats and bools, got {sums.dtype} and {told.dtype}")
        sums = xp.where(told, sums, xp.zeros_like(sums))
        if not bool(xp.all(xp.abs(sums) <= LARGEST_N)):  # NaN fails this form of the test
            raise InputError("a valid sum is not finite, or above 1e6: expected newtons")
        # asarray with a dtype, because CuPy 13 has no function astype.
        counts, sums = xp.asarray(told, dtype=self._kind), xp.asarray(sums, dtype=self._kind)
        mask = xp.take(counts, self._slot, axis=1) * (self._kept * self._step)
        return mask, xp.take(sums, self._slot, axis=1) * mask

    def _slope(self, images: Any, mask: Any, target: Any) -> Any:
        """Return Φᵀ W (Φ x - y) / L."""
        xp = self._xp
        frames = images.shape[0]
        taxels = xp.take(xp.reshape(images, (frames, -1)), self._order, axis=1)
        residual = mask * self._transform(taxels) - target
        return xp.reshape(xp.take(self._transform(residual), self._place, axis=1), images.shape)

    def _transform(self, values: Any) -> Any:
        xp = self._xp
        blocks = xp.reshape(values, (values.shape[0], *self._blocks))
        return xp.reshape(xp.matmul(blocks, self._hadamard), values.shape)

    def _shrink(self, images: Any) -> Any:
        xp = self._xp
        s = xp.matmul(xp.matmul(self._down, images), self._across.T)
        s = s - xp.clip(s, -self._threshold, self._threshold)
        made = xp.matmul(xp.matmul(self._down.T, s), self._across)
        return xp.where(made > 0, made, xp.zeros_like(made)) if self._nonnegative else made


def _turns(cycles: int, parts: int) -> Iterator[tuple[npt.NDArray[np.intp], Bools, bool]]:
    """Yield for each turn the cycle of every part, whether this cycle is in the recording, and if images are kept.

    A part whose cycle is outside the recording gets another cycle; its image is not used.
    """
    length = -(-cycles // parts)
    starts = np.arange(parts) * length
    for turn in range(-RUN_IN if cycles and parts > 1 else 0, length):
        at = starts + turn
        used = (at >= 0) & (at < cycles)
        yield np.clip(at, 0, cycles - 1), used, turn >= 0
