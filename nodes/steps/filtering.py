"""From samples to sums: the noise of a patch filtered away, clipping undone, and the sums of what is left.

`nodes/firmware/c/steps/skin_filter.c` is the same for real boards, with `nodes.steps.following` and the unclipping of
`nodes.steps.noise`. The vectors of `skin contract` (`nodes.steps.vectors`) guard both, bit for bit.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dbc.patch_filter import (
    HORIZON,
    IDLE_SAMPLES,
    SETTLING_SAMPLES,
    WINDOW,
    Floats,
    Models,
    make_models,
    unclip_table,
)
from nodes.steps.following import OffsetState, ScaleSums, follow, gather, judged, new_offsets
from nodes.steps.models import Tracks, new_tracks, step
from nodes.steps.noise import IdleStatistics, Noise, unclip
from nodes.steps.transforms import from_haar, to_haar, to_walsh, to_walsh_variance
from shell.compiled import njit
from skin.clipping import DEAD_RATIO
from skin.walsh import grouped_rows, haar_matrix, walsh_matrix


class ForceFilter:
    """Filters the samples of the patches of some nodes: every Haar coefficient on its own.

    Parameters
    ----------
    noise : Noise
        What the nodes know of their noise; patches of one taxel are filtered taxel by taxel. The noise is learned on
        while nothing touches, and so are the offsets of taxels, see `nodes.steps.following`.
    taxels : array of int, shape (nodes,), optional
        How many taxels each node has; without it no place is empty.
    horizon : float
        Samples that a forecast looks ahead.

    Attributes
    ----------
    force_n : array of float32, shape (nodes, taxels)
        Forecast forces, newtons.
    noise : Noise
        What the nodes know by now.
    shows_pattern : array of bool, shape (nodes,)
        Whether the samples of a node are those of a test pattern: its offsets stay.
    """

    def __init__(self, noise: Noise, taxels: npt.NDArray[np.intp] | None = None, *, horizon: float = HORIZON) -> None:
        shape = noise.taxel_n.shape
        self._taxels = np.full(shape[0], shape[1]) if taxels is None else taxels
        self._models, self._horizon = make_models(horizon), np.float32(horizon)
        self._tracks = new_tracks(self._models, noise.taxel_n.size)
        self._forecast, self._variance = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._table = unclip_table()
        self._work = np.zeros((2, *shape), np.float32)
        self._offsets = new_offsets(noise.offset_n)
        self.shows_pattern = self._offsets.stays
        self._sums, self._in_window = ScaleSums(*np.zeros((3, *shape), np.float32)), 0
        self.force_n = np.zeros(shape, np.float32)
        self.noise = self._learned = noise
        #: Noise of taxels and coefficients that somebody has set; 0 where none.
        self._given: tuple[Floats, Floats] | None = None

    def give(self, taxel_n: Floats, coefficient_n: Floats) -> None:
        """Use this noise in place of what is learned, newtons, shape (nodes, taxels) each; what is 0 is learned."""
        self._given = (taxel_n, coefficient_n) if taxel_n.any() or coefficient_n.any() else None
        self._use(self._learned)

    def take(self, sample_n: Floats) -> None:
        """Take one sample of every taxel, shape (nodes, taxels), newtons."""
        noise = self.noise
        known = noise.taxel_n, noise.coefficient_n
        learning = self._sums, self._offsets
        models = self._models, self._tracks, self._forecast, self._variance
        _take(sample_n, known, learning, models, self._horizon, self._table, self._work, self.force_n)
        self._in_window += 1
        if self._in_window == WINDOW:
            self._in_window = 0
            # Rescale all noise by the measured factor: that of coefficients is known relative to that of taxels.
            learned = self._learned
            scale = judged(self._sums, learned.taxel_n, self._taxels)
            self._use(replace(learned, taxel_n=learned.taxel_n * scale, coefficient_n=learned.coefficient_n * scale))

    def _use(self, learned: Noise) -> None:
        """Go on with another noise; levels and slopes are in units of the coefficients' noise."""
        before_n, self._learned = self.noise.coefficient_n, learned
        if self._given is not None:
            taxel_n, coefficient_n = self._given
            learned = replace(
                learned,
                taxel_n=np.where(taxel_n > 0, taxel_n, learned.taxel_n),
                coefficient_n=np.where(coefficient_n > 0, coefficient_n, learned.coefficient_n),
            )
        self.noise = learned
        ratio = (learned.coefficient_n / before_n).ravel()
        self._tracks.level[:] /= ratio
        self._tracks.slope[:] /= ratio


class PatchFilter(ForceFilter):
    """Filters the samples of the patches of some nodes, and sums what is left.

    Parameters
    ----------
    noise, taxels
        As for `ForceFilter`; patches of 8 places or more.

    Attributes
    ----------
    sums_n : array of float32, shape (nodes, taxels)
        The Walsh sums of `force_n`, in the order of `skin.walsh.grouped_rows`.
    """

    def __init__(self, noise: Noise, taxels: npt.NDArray[np.intp] | None = None) -> None:
        super().__init__(noise, taxels)
        places = noise.taxel_n.shape[1]
        self._order = grouped_rows(places).ravel()
        #: Variances of Haar coefficients add up to those of sums.
        self._spread = np.rint(np.square(haar_matrix(places) @ walsh_matrix(places).T))
        self._walsh_work, self._variance_n2 = np.zeros(places, np.float32), np.zeros(noise.taxel_n.shape, np.float32)
        self.sums_n = np.zeros(noise.taxel_n.shape, np.float32)

    def take(self, sample_n: Floats) -> None:
        """Take one sample of every taxel, shape (nodes, taxels), newtons."""
        super().take(sample_n)
        to_walsh(self.force_n, self._order, self._walsh_work, self.sums_n)

    @property
    def variance_n2(self) -> Floats:
        """The variance of each of `sums_n`, newtons squared, shape (nodes, taxels); the next call overwrites it."""
        return self.variances_n2(np.arange(len(self._variance)))

    def variances_n2(self, nodes: npt.NDArray[np.intp]) -> Floats:
        """Return `variance_n2`, which is that of now for some nodes alone."""
        to_walsh_variance(nodes, self._variance, self.noise.coefficient_n, self._spread, self._variance_n2)
        return self._variance_n2


def settled_filter(sample: Callable[[], Floats], taxels: npt.NDArray[np.intp]) -> PatchFilter:
    """Return a filter that has learned the noise of the untouched skin, as a board does when it is switched on.

    Parameters
    ----------
    sample : callable
        Returns the next sample of every taxel, shape (nodes, taxels), newtons.
    taxels : array of int, shape (nodes,)
        As for `ForceFilter`.
    """
    first_n = sample()
    statistics = IdleStatistics(*first_n.shape)
    statistics.take(first_n)
    for _ in range(IDLE_SAMPLES - 1):
        statistics.take(sample())
    made = PatchFilter(statistics.noise(), taxels)
    for _ in range(SETTLING_SAMPLES):
        made.take(sample())
    return made


@njit(cache=True, nogil=True, error_model="numpy")
def _take(  # noqa: PLR0917  compiled functions take no keywords
    sample_n: Floats,
    known: tuple[Floats, Floats],
    learning: tuple[ScaleSums, OffsetState],
    models: tuple[Models, Tracks, Floats, Floats],
    horizon: Any,
    table: Floats,
    work: Floats,
    force_n: Floats,
) -> None:
    """Filter one sample, in one call, because calls take long: as `ForceFilter.take`."""
    taxel_n, coefficient_n = known
    scale_sums, offsets = learning
    each_model, tracks, forecast, variance = models
    high, wide = offsets.offset.shape[1:]
    work_n, coefficients = work[0], work[1]
    work_n[:] = sample_n
    gather(work_n, scale_sums)
    to_haar(work_n, high, wide, coefficients)
    flat, ahead, of_noise = coefficients.ravel(), forecast.ravel(), coefficient_n.ravel()
    for c in range(flat.size):
        flat[c] /= of_noise[c]
    step(flat, each_model, tracks, horizon, ahead, variance.ravel())
    for c in range(flat.size):
        flat[c] = ahead[c] * of_noise[c]
    from_haar(coefficients, high, wide, force_n)
    unclip(force_n.ravel(), taxel_n.ravel(), table)
    shape = offsets.offset.shape
    follow(force_n.reshape(shape), taxel_n.reshape(shape), offsets)
    _silence(force_n.ravel(), taxel_n.ravel())


@njit(cache=True, nogil=True)
def _silence(force_n: Floats, noise_n: Floats) -> None:
    """Show taxels as 0 that show no more than their noise, in place."""
    ratio, zero = np.float32(DEAD_RATIO), np.float32(0)
    for k in range(force_n.size):
        force_n[k] = zero if force_n[k] < ratio * noise_n[k] else force_n[k]
