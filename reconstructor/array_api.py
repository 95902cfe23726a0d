"""`reconstructor.fista.iterate` for many streams at once, with NumPy, or CuPy or PyTorch on a GPU.

array-api-compat makes the libraries alike. Every step is a matrix product, a gather or an elementwise operation on
(streams, …) arrays; wavelets and Hadamard blocks are applied as small dense matrices, which are faster on a GPU than
butterflies.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from array_api_compat import to_device

from canskin.errors import InputError
from reconstructor.bases import wavelet_basis
from reconstructor.checks import Values, check_grid_of, float_kind
from reconstructor.fista import clipped, iterate, momentum, soft
from reconstructor.kernels.addresses import spin_shifts
from reconstructor.kernels.blocks import checked
from reconstructor.kernels.graph import graph_of
from reconstructor.kernels.variation import INNER
from reconstructor.settings import Device, LibraryName, SolverSettings
from shell.extras import not_installed
from skin.matrix import MatrixPhi
from skin.phi import Sbhe, fast_hadamard
from skin.surface import grid_surface

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class ArrayLibrary:
    """An array library and where its arrays are.

    Attributes
    ----------
    xp : module
        With the functions of the array standard.
    about : str
        Library, version and device in words.
    device : object
        Of the library; None for its default.
    on_gpu : bool
    """

    xp: ModuleType
    about: str
    device: Any = None
    on_gpu: bool = False

    def send(self, values: npt.NDArray[Any], kind: np.dtype[Any] | None = None) -> Any:
        """Return NumPy's values as an array of the library, with NumPy's dtype or another."""
        wanted = np.require(values, kind, ["C", "W"])  # PyTorch warns of memory that it may not write
        return self.xp.asarray(wanted, dtype=getattr(self.xp, wanted.dtype.name), device=self.device)

    def zeros(self, shape: tuple[int, ...], kind: np.dtype[Any]) -> Any:
        """Return zeros of the library."""
        return self.xp.zeros(shape, dtype=getattr(self.xp, kind.name), device=self.device)

    def fetch(self, values: Any) -> npt.NDArray[Any]:
        """Return an array of the library as one of NumPy."""
        return np.asarray(to_device(values, "cpu") if self.on_gpu else values)

    @property
    def captures(self) -> bool:
        """Whether `captured` works: with PyTorch on a GPU."""
        return self.on_gpu and self.device is not None

    def captured(self, compute: Callable[..., None], arrays: tuple[Any, ...]) -> Callable[..., None]:
        """Return `compute`, which changes its first array, as one CUDA graph for arrays of these shapes.

        The graph starts hundreds of operations at the cost of one. Call `compute` once before: libraries load.
        """
        import torch

        held = [each.clone() for each in arrays]
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            compute(*held)

        def replay(*given: Any) -> None:
            for to, each in zip(held, given, strict=True):
                to[...] = each
            graph.replay()
            given[0][...] = held[0]

        return replay


NUMPY: Final = ArrayLibrary(np, f"NumPy {np.__version__} on the CPU")


def array_library(device: Device, name: LibraryName | None = None) -> ArrayLibrary:
    """Return an array library that computes on a device.

    Parameters
    ----------
    device : {"cpu", "gpu"}
    name : {"cupy", "torch", "numpy"}, optional
        Default: of a GPU PyTorch, which has CUDA graphs here, else CuPy; of a CPU NumPy.

    Raises
    ------
    InputError
        If the library is not installed, finds no GPU, or has nothing to do with this device.
    """
    if device == "cpu" and name == "cupy":
        raise InputError("CuPy computes on a GPU: expected --device gpu, or the library torch or numpy")
    if device == "gpu" and name == "numpy":
        raise InputError("NumPy computes on a CPU: expected --device cpu, or the library cupy or torch")
    if device == "cpu":
        return _torch("cpu") if name == "torch" else NUMPY
    if name is not None:
        return _torch("gpu") if name == "torch" else _cupy()
    try:
        return _torch("gpu")
    except InputError as error:
        try:
            return _cupy()
        except InputError as other:
            raise InputError(f"{error}; {other}") from error


def _cupy() -> ArrayLibrary:
    try:
        import cupy
    except ImportError as error:
        raise not_installed(f"CuPy cannot be loaded ({error})", "gpu") from error
    try:
        cupy.cuda.runtime.getDeviceCount()
        name = cupy.cuda.runtime.getDeviceProperties(0)["name"].decode()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise InputError(f"CuPy finds no GPU: {error}") from error
    import array_api_compat.cupy as xp

    return ArrayLibrary(xp, f"CuPy {cupy.__version__} on {name}", on_gpu=True)


def _torch(device: Device) -> ArrayLibrary:
    try:
        import array_api_compat.torch as xp
        import torch
    except ImportError as error:
        raise not_installed(f"PyTorch cannot be loaded ({error})", "torch") from error
    about = f"PyTorch {torch.__version__} on"
    if device == "cpu":
        return ArrayLibrary(xp, f"{about} the CPU")
    if not torch.cuda.is_available():
        raise InputError(f"PyTorch {torch.__version__} finds no GPU")
    return ArrayLibrary(xp, f"{about} {torch.cuda.get_device_name(0)}", torch.device("cuda", 0), on_gpu=True)


class BatchSolver:
    """min ½‖Φx - y‖² + λ R(x) by FISTA as `reconstructor.kernels.blocks.BlockSolver`, for many streams at once.

    Parameters
    ----------
    phi : Sbhe
        Not a MatrixPhi.
    rows, columns : int
        1 to 256; for a wavelet powers of two from 8.
    settings : SolverSettings
        Any prior except the contourlet.
    library : ArrayLibrary
    edges : array of int, shape (edges, 2), optional
        As of `reconstructor.kernels.blocks.BlockSolver`.

    Attributes
    ----------
    streams : int
        Images that are solved together, each from its own sums and start: 1, see `of_streams`.
    """

    def __init__(
        self,
        phi: Sbhe | MatrixPhi,
        rows: int,
        columns: int,
        settings: SolverSettings,
        *,
        library: ArrayLibrary = NUMPY,
        edges: Indices | None = None,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        if settings.prior == "contourlet" or isinstance(phi, MatrixPhi):
            got = "contourlets" if settings.prior == "contourlet" else "a matrix"
            raise InputError(
                f"a GPU solves sums of blocks, with total variation or a wavelet: got {got}; leave out --device gpu"
            )
        check_grid_of(phi, rows, columns, settings.prior, edges)
        self.dtype: Final = float_kind(dtype)
        self.sums: Final = phi.shape[0]
        self.shape: Final = (rows, columns)
        self.streams = 1
        self._library, taxels, places = library, rows * columns, phi.order.size
        send, kind = library.send, self.dtype
        step = 1 / (settings.lipschitz_ratio * phi.norm_squared)
        self._threshold = settings.penalty_n * step
        self._momentum = [send(each, kind) for each in momentum(settings.iterations).reshape(-1, 1)]
        self._is_scaled = settings.scaled_start
        self._zero = library.zeros((1,), kind)
        self._floor = self._zero if settings.nonnegative else None
        self._hadamard = send(np.asarray(fast_hadamard(np.eye(phi.block_size))), kind)
        self._order, self._empty = send(phi.order), int((phi.order >= taxels).sum())
        held = phi.order < taxels
        place, is_wired = np.zeros(taxels, np.intp), np.zeros(taxels, np.bool_)
        place[phi.order[held]], is_wired[phi.order[held]] = np.flatnonzero(held), True
        self._place = send(place)
        self._wired = None if is_wired.all() else send(np.asarray(is_wired), kind)
        is_sent, slot = np.zeros(places, np.bool_), np.zeros(places, np.intp)
        sent = np.flatnonzero(phi.kept)
        is_sent[sent], slot[sent] = True, np.arange(self.sums)
        self._slot, self._steps = send(slot), send(np.asarray(step * is_sent), kind)
        self._prior: _Variation | _Wavelet = (
            _Variation(library, kind, self.shape, gaps=np.flatnonzero(~is_wired), edges=edges, floor=self._floor)
            if settings.prior == "variation"
            else _Wavelet(library, kind, settings, self.shape)
        )
        self._dual = self._prior.new_dual(1)
        self._run: Callable[..., None] | None = None

    def of_streams(self, streams: int) -> "BatchSolver":
        """Return a solver of as many streams, with a state of its own."""
        made = copy(self)
        made.streams = streams
        made.reset()
        return made

    def new_estimate(self) -> Any:
        """Return estimates of zeros, an array of the library of shape (streams, rows, columns)."""
        return self._library.zeros((self.streams, *self.shape), self.dtype)

    def solve(self, estimate: Any, sums_n: Values, weights: Values, *, relative_penalty: float | Values = 1.0) -> int:
        """Solve in place from `estimate` and return the number of sums used.

        Parameters
        ----------
        estimate : array of the library, shape (streams, rows, columns)
            Start and result in newtons. A stream without any sum becomes 0, and its state is reset.
        sums_n, weights : NumPy arrays of `dtype`, shape (streams, m), or (m,) for one stream
            As of `reconstructor.kernels.blocks.BlockSolver.solve`.
        relative_penalty : float, or array of shape (streams,)
            λ of this solve / λ of the settings.
        """
        self._check(estimate)
        lead = (self.streams,) if self.streams > 1 or np.ndim(sums_n) > 1 else ()
        sums, counting = checked(sums_n, weights, (*lead, self.sums), self.dtype)
        if not np.all(np.isfinite(relative_penalty)) or np.any(np.asarray(relative_penalty) < 0):
            raise InputError(f"the relative penalty needs numbers of 0 or above: got {relative_penalty}")
        counts = counting.reshape(-1, self.sums) > 0
        xp, send, kind = self._library.xp, self._library.send, self.dtype
        sums = np.where(counts, sums.reshape(counts.shape), 0)
        gain = xp.take(send(counting.reshape(counts.shape), kind), self._slot, axis=1) * self._steps
        target = xp.take(send(sums, kind), self._slot, axis=1) * gain
        limit = send(np.full(self.streams, self._threshold) * relative_penalty, kind)
        lives = counts.any(axis=1)
        problem = (estimate, gain, target, xp.reshape(limit, (-1, 1, 1)))
        (self._run or self._solve)(*problem)
        if self._run is None and self._library.captures:
            self._run = self._library.captured(self._solve, problem)
        if not lives.all():
            self._scale(estimate, xp.reshape(send(np.asarray(lives), kind), (-1, 1, 1)))
        return int(np.count_nonzero(counts))

    def reset(self) -> None:
        """Reset the state besides the estimates."""
        self._dual, self._run = self._prior.new_dual(self.streams), None

    def deliver(self, estimate: Any) -> npt.NDArray[np.float32]:
        """Return new NumPy images of shape (streams, rows, columns), negative forces as 0."""
        self._check(estimate)
        images: npt.NDArray[np.float32] = np.maximum(self._library.fetch(estimate), 0).astype(np.float32)
        return images

    def _check(self, estimate: Any) -> None:
        shape = (self.streams, *self.shape)
        if tuple(getattr(estimate, "shape", ())) != shape:
            raise InputError(f"estimate: expected an array of shape {shape}, as `new_estimate` returns")

    def _solve(self, estimate: Any, gain: Any, target: Any, limit: Any) -> None:
        if self._is_scaled:
            self._scale(estimate, self._kept(estimate, gain, target))

        def descent(ahead: Any) -> Any:
            return self._slope(ahead, gain, target)

        def proximal(images: Any, iteration: int) -> Any:
            made = self._prior(images, self._dual, limit, iteration)
            return made if self._floor is None else self._library.xp.maximum(made, self._floor)

        estimate[...] = iterate(estimate, descent, proximal, self._momentum)

    def _scale(self, estimate: Any, factor: Any) -> None:
        """Scale the start of each stream, and the dual, which belongs to the start; `factor` has 3 axes."""
        for each in (estimate, *self._dual):
            each[...] = each * factor

    def _kept(self, start: Any, gain: Any, target: Any) -> Any:
        """Return the factor of each start, see `SolverSettings.scaled_start`, shape (streams, 1, 1)."""
        xp = self._library.xp
        seen = gain * self._transform(self._placed(start))
        explained, energy = xp.sum(seen * target, axis=1), xp.sum(seen * seen, axis=1)
        excess, one = explained + explained - energy, self._zero + 1
        ratio = xp.maximum(excess, self._zero) / xp.where(energy > 0, energy, one)
        return xp.reshape(xp.where(excess >= energy, one, ratio), (-1, 1, 1))

    def _slope(self, images: Any, gain: Any, target: Any) -> Any:
        """Return Φᵀ W (Φ x - y) / L."""
        xp = self._library.xp
        residual = gain * self._transform(self._placed(images)) - target
        slope = xp.take(self._transform(residual), self._place, axis=1)
        return xp.reshape(slope if self._wired is None else slope * self._wired, images.shape)

    def _placed(self, images: Any) -> Any:
        """Return the taxels in block order, shape (streams, places)."""
        xp = self._library.xp
        taxels = xp.reshape(images, (images.shape[0], -1))
        if self._empty:
            nothing = self._library.zeros((images.shape[0], self._empty), self.dtype)
            taxels = xp.concat((taxels, nothing), axis=1)
        return xp.take(taxels, self._order, axis=1)

    def _transform(self, values: Any) -> Any:
        """Return the Hadamard transform of each block, shape (streams, places)."""
        xp = self._library.xp
        blocks = xp.reshape(values, (values.shape[0], -1, self._hadamard.shape[0]))
        return xp.reshape(xp.matmul(blocks, self._hadamard), values.shape)


class _Wavelet:
    """Ψ soft(Ψᵀ X) of an orthogonal wavelet."""

    def __init__(
        self, library: ArrayLibrary, kind: np.dtype[Any], settings: SolverSettings, shape: tuple[int, int]
    ) -> None:
        self._xp = library.xp
        steps = wavelet_basis(settings.prior, *shape).steps
        self._steps = [tuple(library.send(each, kind) for each in (h, h.T, k, k.T)) for h, k in steps]
        self._shifts = spin_shifts(settings.spins, *shape)

    def new_dual(self, streams: int) -> tuple[Any, ...]:
        """Return no dual."""
        del streams
        return ()

    def __call__(self, images: Any, dual: tuple[Any, ...], limit: Any, turn: int) -> Any:
        """Shrink the images, which are overwritten."""
        del dual
        xp, (down, right) = self._xp, self._shifts[turn % len(self._shifts)]
        s = xp.roll(images, (down, right), axis=(1, 2)) if down or right else images
        for h, _, _, k_t in self._steps:
            rows, columns = h.shape[0], k_t.shape[0]
            s[:, :rows, :columns] = xp.matmul(xp.matmul(h, s[:, :rows, :columns]), k_t)
        s = soft(s, limit, xp)
        for _, h_t, k, _ in reversed(self._steps):
            rows, columns = h_t.shape[0], k.shape[0]
            s[:, :rows, :columns] = xp.matmul(xp.matmul(h_t, s[:, :rows, :columns]), k)
        return xp.roll(s, (-down, -right), axis=(1, 2)) if down or right else s


class _Variation:
    """Less total variation by a few steps on the dual, as `reconstructor.kernels.variation.denoise`.

    On a full grid the dual has an element at every border between two taxels, and at the edge of the grid, where it
    stays 0. On any other skin it has shape (streams, 1, edges): taxels are gathered by edge, and edges by taxel.
    """

    def __init__(
        self,
        library: ArrayLibrary,
        kind: np.dtype[Any],
        shape: tuple[int, int],
        *,
        gaps: Indices,
        edges: Indices | None,
        floor: Any,
    ) -> None:
        self._library, self._kind, self._shape, self._floor = library, kind, shape, floor
        graph = graph_of(*shape, gaps, edges)
        self._is_grid, self._step = graph.is_grid, 1 / graph.bound
        pairs = grid_surface(*shape, 1.0, gaps).edges if edges is None else np.sort(edges, axis=1)
        self._edges, taxels = len(pairs), shape[0] * shape[1]
        self._low, self._high = library.send(pairs[:, 0]), library.send(pairs[:, 1])
        self._of_taxel = library.send(_edges_of_taxels(pairs, taxels).ravel())

    def new_dual(self, streams: int) -> tuple[Any, ...]:
        """Return the dual of images of this shape, zeros."""
        zeros, kind, (rows, columns) = self._library.zeros, self._kind, self._shape
        if self._is_grid:
            return zeros((streams, rows + 1, columns), kind), zeros((streams, rows, columns + 1), kind)
        return (zeros((streams, 1, self._edges), kind),)

    def __call__(self, images: Any, dual: tuple[Any, ...], limit: Any, turn: int) -> Any:
        """Return the images with less total variation, and change the dual."""
        del turn
        xp, smooth, ascend = self._library.xp, self._smooth_graph, self._ascend_graph
        if self._is_grid:
            smooth, ascend = self._smooth_grid, self._ascend_grid
        for _ in range(INNER):
            made = smooth(images, dual)
            ascend(made if self._floor is None else xp.maximum(made, self._floor), dual, limit)
        return smooth(images, dual)

    def _smooth_grid(self, images: Any, dual: tuple[Any, ...]) -> Any:
        down, right = dual
        made = images + down[:, 1:, :] - down[:, :-1, :]
        return made + right[:, :, 1:] - right[:, :, :-1]

    def _ascend_grid(self, made: Any, dual: tuple[Any, ...], limit: Any) -> None:
        down, right = dual
        down[:, 1:-1, :] = self._climbed(down[:, 1:-1, :], made[:, 1:, :] - made[:, :-1, :], limit)
        right[:, :, 1:-1] = self._climbed(right[:, :, 1:-1], made[:, :, 1:] - made[:, :, :-1], limit)

    def _smooth_graph(self, images: Any, dual: tuple[Any, ...]) -> Any:
        xp, (along,), streams = self._library.xp, dual, images.shape[0]
        signed = xp.concat((along, -along, self._library.zeros((streams, 1, 1), self._kind)), axis=2)
        gathered = xp.reshape(xp.take(signed, self._of_taxel, axis=2), (*images.shape, -1))
        return images + xp.sum(gathered, axis=3)

    def _ascend_graph(self, made: Any, dual: tuple[Any, ...], limit: Any) -> None:
        xp, (along,) = self._library.xp, dual
        flat = xp.reshape(made, (made.shape[0], 1, -1))
        slope = xp.take(flat, self._high, axis=2) - xp.take(flat, self._low, axis=2)
        along[...] = self._climbed(along, slope, limit)

    def _climbed(self, dual: Any, slope: Any, limit: Any) -> Any:
        return clipped(dual + self._step * slope, limit, self._library.xp)


def _edges_of_taxels(pairs: Indices, taxels: int) -> Indices:
    """Return a row for each taxel, shape (taxels, K), of its places in [dual, -dual, 0]: at low or high ends."""
    count = len(pairs)
    ends = pairs.T.ravel()
    order = np.argsort(ends, kind="stable")
    degrees = np.bincount(ends, minlength=taxels)
    table = np.full((taxels, degrees.max(initial=1)), 2 * count, np.intp)
    table[ends[order], np.arange(ends.size) - np.repeat(np.cumsum(degrees) - degrees, degrees)] = order
    return table
