"""`Reconstructor`: one tactile image per cycle, from the sums of this and of earlier cycles."""

from collections import deque
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import Values, check_grid_of
from reconstructor.coded_memory import CodedMemory
from reconstructor.kernels.contourlet import ContourletSolver
from reconstructor.kernels.haar import HaarSolver
from reconstructor.kernels.matrix import MatrixSolver
from reconstructor.kernels.variation import VariationSolver
from reconstructor.settings import LIVE, SolverSettings
from reconstructor.temporal_filter import TemporalFilter
from reconstructor.wavelet_solver import WaveletSolver
from skin.clipping import ClipCorrection
from skin.matrix import MatrixPhi
from skin.phi import Phi, Sbhe
from skin.surface import Surface

#: Noise of one sum of 32 untouched taxels whose noise of 1 mN is clipped at 0: √(32 (1/2 - 1/2π)) mN.
SUM_NOISE_N: Final = 0.0033
#: λ = `penalty_n` is right for averaged sums whose noise floor (`TemporalFilter.noise_n`) is this, where 10 samples are
#: averaged from SYNC to SYNC: with 1 mN of noise the floor is a quarter. On the scenes of `skin evaluate rivals`
#: a quarter is within 0.2 dB of the best of 0.1 to 1.2.
AVERAGED_SUM_NOISE_N: Final = 0.00019
AVERAGED_SAMPLES: Final = 10
#: The same where Φ changes from frame to frame: the image before holds what earlier frames told. The floor is that of
#: the sums' differences from those of the image before. On 10 x 10 taxels with 15 random 0/1 sums, 0.006 to 0.025
#: N are within 1 dB of the best, for noise of 0.2 and of 1 mN.
CODED_SUM_NOISE_N: Final = 0.012
#: Nodes average less while a touch moves. So λ grows with the root of the sums' change from cycle to cycle, where
#: change / noise floor is above `MOVING_FROM`, to `MOVING_MOST` at most.
MOVING_FROM: Final = 10.0
MOVING_MOST: Final = 4.0
#: Where sums come in two turns, images start from images of half a period before, and λ is this part of the above; it
#: grows with the change itself, because halves of different instants contradict each other while a touch moves. On the
#: scenes of `skin evaluate rivals` 0.25 to 0.4 are within 0.1 dB of the best.
TURNS_PENALTY: Final = 0.3
#: The slowest average of a node forgets this part from sample to sample.
SLOWEST_GAIN: Final = 1 / 256
#: Bounds of the scaled λ / `penalty_n`; with a smaller λ, ten iterations would not fill missing blocks.
LEAST_PENALTY: Final = 0.03
MOST_PENALTY: Final = 10.0

Solver = VariationSolver | HaarSolver | ContourletSolver | MatrixSolver | WaveletSolver


class Reconstructor:
    """The solver of the service.

    Every call starts from the previous image. Parts of an old image in the null space of Φ would stay, so the start is
    first scaled by its agreement with the sums (`scaled_start`): by 1 while a touch moves slowly, by 0 when another
    touch has replaced it.

    With `temporal_filter`, sums are averaged over cycles with the gain of `TemporalFilter`, and λ is scaled with their
    noise; λ = `penalty_n` for sums of one cycle with a noise of `SUM_NOISE_N`. Sums that the nodes
    have averaged (`samples`) are taken as they come; λ is scaled with their noise and with their change.

    The taxels of a missing block are estimated from the taxels around them, somewhat too low. Old values vanish within
    a few cycles, within one or two while the touch moves. Without any valid sum the image is zero, and past sums and
    images are dropped.

    A Φ that changes from frame to frame is an argument of each solve. Its sums are not averaged: those of two frames
    have nothing in common but the force. The image before is the memory, without `scaled_start`, and only a part of the
    iterations is made (`reconstructor.coded_memory`).

    Parameters
    ----------
    phi : Phi
        The skin's Φ: an `Sbhe`, or a `MatrixPhi` of one frame or more.
    rows, columns : int
        The grid, 1 to 256; for a wavelet powers of two from 8.
    noise_n : float, optional
        Standard deviation of the noise of a sensor that clips at 0, to correct the bias of clipping. 0 and None: no
        correction.
    samples : int
        Samples of each taxel from one SYNC to the next (`skin.layout.Layout.samples_per_sync`). Where there are more
        than one, sums come averaged and without the bias of clipping, and `noise_n` has to be left out or 0.
    turns : int
        Cycles in which every sum comes once (`skin.layout.Sync.turns`): each measurement has the newest of every sum.
    edges : array of int, shape (edges, 2), optional
        Pairs of neighbours of a skin that is no grid (`skin.surface.Surface.graph`).
    """

    def __init__(
        self,
        phi: Sbhe | MatrixPhi,
        rows: int,
        columns: int,
        settings: SolverSettings = LIVE,
        *,
        noise_n: float | None = None,
        samples: int = 1,
        turns: int = 1,
        edges: npt.NDArray[np.intp] | None = None,
    ) -> None:
        self._kernel = make_solver(phi, rows, columns, settings, edges=edges)
        if noise_n and samples > 1:
            raise InputError(
                f"nodes that average (sampling.rate_hz of the layout) undo the bias of clipping themselves:"
                f" leave the sensor's noise out, got {noise_n:g} N"
            )
        self._correct = ClipCorrection(noise_n) if noise_n else None
        self._is_coded = phi.frames > 1
        self._memory = CodedMemory(*phi.shape[::-1], self._kernel.dtype)
        self._comes_averaged = samples > 1 or self._is_coded
        #: One for each turn, that of the next cycle first: all sums are new to each of them.
        self._filters = deque(
            TemporalFilter(phi.shape[0], self._kernel.dtype, averages=not self._comes_averaged) for _ in range(turns)
        )
        self._sum_noise_n = SUM_NOISE_N if samples == 1 else averaged_sum_noise_n(samples * turns)
        if self._is_coded:
            self._sum_noise_n = CODED_SUM_NOISE_N
        self._phi = phi
        self._settings = settings
        self._estimate = self._kernel.new_estimate()

    def solve(
        self, sums_n: npt.NDArray[np.floating[Any]], valid_sums: npt.NDArray[np.bool_], phi: Phi | None = None
    ) -> npt.NDArray[np.float32]:
        """Return the image of one cycle.

        Parameters
        ----------
        sums_n : array, shape (m,)
            Newtons; values of sums that are not valid have no effect.
        valid_sums : array of bool, shape (m,)
        phi : Phi, optional
            That of these sums; needed where it changes from frame to frame (`skin.phi.Phi.of_cycle`).

        Returns
        -------
        array of float32, shape (rows, columns)
            Newtons, never negative.

        Raises
        ------
        InputError
            If a shape or dtype does not fit, or a valid sum is not finite or above 1e6 N.
        """
        phi, kernel = phi or self._phi, self._kernel
        if phi.frames > 1 or phi.shape != self._phi.shape or not (self._is_coded or phi is self._phi):
            raise InputError("expected the Φ of this frame where Φ changes from frame to frame, else that of the skin")
        remembers = self._is_coded and self._settings.temporal_filter
        if remembers and isinstance(phi, MatrixPhi):
            self._filters[0].expect(self._memory.expect(self._estimate, phi))
        sums, weights, relative_penalty = self.average(sums_n, valid_sums)
        if not valid_sums.any():
            self.reset()
        else:
            solve = kernel.solve
            if isinstance(kernel, MatrixSolver):
                part = self._memory.follow(self._estimate, sums, valid_sums) if remembers else 1.0
                solve = partial(kernel.solve, phi=phi, part=part)
            solve(self._estimate, sums, weights, relative_penalty=relative_penalty)
        image = kernel.deliver(self._estimate).reshape(kernel.shape)
        return image if self._correct is None else self._correct(image)

    def average(
        self, sums_n: npt.NDArray[np.floating[Any]], valid_sums: npt.NDArray[np.bool_]
    ) -> tuple[Values, Values, float]:
        """Return what one cycle is solved from: averaged sums, their weights, both views, and the factor of λ.

        Parameters and errors are those of `solve`.
        """
        filtered = self._filters[0]
        for each in (sums_n, valid_sums):
            if not isinstance(each, np.ndarray):
                raise InputError(f"expected arrays, got {type(each).__name__}")
        expected = filtered.sums.shape
        if sums_n.shape != expected or valid_sums.shape != expected:
            raise InputError(
                f"Φ gives {expected[0]} sums: got sums of shape {sums_n.shape} and validity of {valid_sums.shape}"
            )
        if sums_n.dtype.kind != "f" or valid_sums.dtype != np.bool_:
            raise InputError(f"expected floats and bools, got {sums_n.dtype} and {valid_sums.dtype}")
        if not self._settings.temporal_filter:
            filtered.reset()
        with np.errstate(over="ignore"):  # invalid sums may hold any value
            sums = np.ascontiguousarray(sums_n, self._kernel.dtype)
        if not filtered.take(sums, np.ascontiguousarray(valid_sums)):
            raise InputError("a valid sum is not finite, or above 1e6: expected newtons")
        self._filters.rotate(-1)
        return filtered.sums, filtered.weights, self._relative_penalty(filtered)

    def _relative_penalty(self, filtered: TemporalFilter) -> float:
        """Return the factor of λ: proportional to the noise of the averaged sums."""
        if not self._settings.temporal_filter:
            return 1.0
        noise_n = filtered.noise_n
        seen = min(max(noise_n / self._sum_noise_n, LEAST_PENALTY), MOST_PENALTY) if noise_n else 1.0
        if not self._comes_averaged:
            return seen * filtered.noise_ratio
        turns = len(self._filters)
        moving = float(max(1.0, filtered.surprise / MOVING_FROM) ** (turns / 2))
        return seen * min(MOVING_MOST, (TURNS_PENALTY if turns > 1 else 1.0) * moving)

    def reset(self) -> None:
        """Drop previous images and sums."""
        self._estimate[...] = 0
        self._kernel.reset()
        for each in self._filters:
            each.reset()
        self._memory.reset()

    def restart(self) -> None:
        """Return to the state after construction."""
        self.reset()
        for each in self._filters:
            each.restart()

    def warm_up(self) -> None:
        """Compile the solver, or load the compiled solver, so that the first cycle is as fast as the others."""
        nothing = np.zeros(self._phi.shape[0], self._kernel.dtype)
        for cycle in (1, 2):
            self.solve(nothing, nothing == 0, self._phi.of_cycle(cycle))
        self.restart()


def reconstruct(
    sums_n: npt.NDArray[np.floating[Any]],
    phi: Sbhe | MatrixPhi,
    surface: Surface,
    settings: SolverSettings = LIVE,
    *,
    valid_sums: npt.NDArray[np.bool_] | None = None,
    cycles: npt.NDArray[np.integer[Any]] | None = None,
    noise_n: float | None = None,
    samples: int = 1,
    turns: int = 1,
) -> npt.NDArray[np.float32]:
    """Return the images of sums, frame after frame, as the service makes them: newtons, shape (frames, rows, columns).

    Parameters
    ----------
    sums_n : array, shape (frames, m)
        Newtons.
    phi : Sbhe or MatrixPhi
        Of the sums.
    surface : Surface
        Of the taxels, n of them (`skin.surface`).
    valid_sums : array of bool, shape (frames, m), optional
        Default: all.
    cycles : array of int, shape (frames,), optional
        Number of each frame's cycle, for a Φ that changes; default: 1, 2, 3 and so on.
    noise_n, samples, turns
        As of `Reconstructor`.

    Examples
    --------
    >>> codes = np.random.default_rng(1).integers(0, 2, (500, 15, 100))
    >>> images = reconstruct(sums_n, MatrixPhi(codes), grid_surface(10, 10, 0.004, gaps=np.arange(0)))
    """
    known = {"noise_n": noise_n, "samples": samples, "turns": turns, "edges": surface.graph}
    engine = Reconstructor(phi, *surface.shape, settings, **known)  # type: ignore[arg-type]  # of several types
    whole = np.ones(sums_n.shape, np.bool_) if valid_sums is None else valid_sums
    numbers = np.arange(1, len(sums_n) + 1) if cycles is None else cycles
    images = np.empty((len(sums_n), *surface.shape), np.float32)
    for image, came, came_valid, cycle in zip(images, sums_n, whole, numbers.tolist(), strict=True):
        image[:] = engine.solve(came, came_valid, phi.of_cycle(cycle))
    return images


def averaged_sum_noise_n(samples: int) -> float:
    """Return `AVERAGED_SUM_NOISE_N` for other numbers of samples: the more, the more an average moves in one cycle."""

    def forgotten(count: int) -> float:
        return float(1 - (1 - SLOWEST_GAIN) ** count)

    return AVERAGED_SUM_NOISE_N * float((forgotten(samples) / forgotten(AVERAGED_SAMPLES)) ** 0.5)


def make_solver(
    phi: Sbhe | MatrixPhi,
    rows: int,
    columns: int,
    settings: SolverSettings,
    *,
    edges: npt.NDArray[np.intp] | None = None,
    dtype: npt.DTypeLike = np.float32,
) -> Solver:
    """Return the solver of a prior: compiled, unless the wavelet is not Haar."""
    if isinstance(phi, MatrixPhi):
        return MatrixSolver(phi, rows, columns, settings, edges=edges, dtype=dtype)
    if settings.prior == "contourlet":
        check_grid_of(phi, rows, columns, settings.prior, edges)
        return ContourletSolver(phi, rows, columns, settings, dtype=dtype)
    for solver in (VariationSolver, HaarSolver):
        if settings.prior in solver.priors:
            return solver(phi, rows, columns, settings, edges=edges, dtype=dtype)
    return WaveletSolver(phi, rows, columns, settings, edges=edges, dtype=dtype)
