"""The electronics of boards that add currents before one converter for each sum."""

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from nodes.electronics import Electronics
from skin.defects import NO_DEFECTS, Defects, Force
from skin.frontend import SumConverter, SumModel, converter
from skin.layout import Layout
from skin.phi import Sbhe
from skin.taxel import NOISE_N


class AnalogueElectronics(Electronics):
    """An analogue front end: no taxel is clipped, and the converters read sums.

    A test pattern shows what the converters would read of taxels with its counts. The boards have neither gains nor
    offsets of taxels.

    Parameters
    ----------
    layout : Layout
        With an analogue front end; raise InputError unless all sums of a block are read within a period.
    phi : Sbhe
        Of the layout.
    noise_n : float
        Standard deviation of the noise of a taxel, newtons.
    seed : int
        Same seed, same noise.
    """

    def __init__(
        self,
        layout: Layout,
        phi: Sbhe,
        *,
        noise_n: float = NOISE_N,
        seed: int = 0,
        defects: Defects = NO_DEFECTS,
    ) -> None:
        super().__init__(
            layout.taxels,
            noise_n=noise_n,
            seed=seed,
            defects=defects,
            period_s=layout.sync.period_s,
            places=phi.wired.taxels,
        )
        self._phi = phi
        self._sum_model = SumModel(phi, defects)
        self.converter = _converter(layout)
        times_s = self._sum_model.row_times_s
        if times_s is not None and times_s.max() > self.period_s:
            rows = int(np.diff(phi.starts).max())
            raise InputError(f"skew: {rows} sums of a block take longer than a period")
        self._signal_n: Force = np.zeros(layout.taxels.count, np.float32)
        self._moment_n: Force = np.zeros((layout.taxels.rows, layout.taxels.columns), np.float32)
        #: What the converters read last.
        self._codes = np.zeros(phi.shape[0], np.int32)

    @property
    def is_skewed(self) -> bool:
        """Whether the sums of a block are read one after the other."""
        return self._sum_model.row_times_s is not None

    @property
    def signal_n(self) -> Force:
        """The currents of the taxels at the newest step, newtons, shape (n,): not clipped."""
        return self._signal_n

    def prepare(self, force_n: Force, step: int) -> None:
        """Draw the noise at `step` before the sums are asked for."""
        if step != self.sampled_ahead:
            time_s = np.array([self.period_s * step])
            moments_n = self._moments_n(force_n, step)
            signal_n = self._model.signal_of_moments(moments_n, self._random, time_s, clips=False)
            self._signal_n, self._moment_n, self.sampled_ahead = signal_n.ravel(), moments_n[0], step

    def read_sums(self, force_n: Force, later_n: Force | None, step: int) -> npt.NDArray[np.int32]:
        """Return what the converters read, in counts of a taxel, shape (m,).

        Parameters
        ----------
        force_n : array of float32, shape (rows, columns)
            True forces at `step`.
        later_n : array of float32, shape (rows, columns), optional
            True forces at the next step, where sums are read one after the other.
        """
        self.prepare(force_n, step)
        self.sampled_ahead = -1
        change_n_per_s = None if later_n is None else self._change_n_per_s(force_n, later_n, step)
        phi = self._phi
        sums_n = self._sum_model.sums_n(
            self._signal_n, self._random, change_n_per_s=change_n_per_s, time_s=self.period_s * step
        )
        counts = self.converter.counts(sums_n)
        for stop in self._model.defects.stops:
            if self.period_s * step >= stop.start_s:
                counts[stop.sums] = self._codes[stop.sums]
        self._codes = counts
        shown = self.pattern[phi.taxels_of_blocks]
        if (shown >= 0).any():
            pattern = np.asarray(phi.wired.forward(np.maximum(self.pattern, 0)), np.float64)
            counts = np.where((shown[:, 0] >= 0)[phi.block_of_sum], self.converter.rounded(pattern), counts)
        return counts

    def _change_n_per_s(self, force_n: Force, later_n: Force, step: int) -> Force:
        """Return how fast the currents of the taxels change after `step`, shape (n,): all defects, no noise."""
        model = self._model
        damped_n = model.damped_n(np.stack([force_n, later_n]), self.period_s)[1:]
        later_n = model.remembered_n(damped_n, self._memory, self.period_s)[0][0]
        felt_n = model.felt_n(np.stack([self._moment_n, later_n]), self.period_s * np.array([step, step + 1]))
        change_n_per_s: Force = (felt_n[1] - felt_n[0]).ravel() / np.float32(self.period_s)
        fixed_n = model.fixed_n(force_n.shape)
        if fixed_n is not None:
            change_n_per_s[~np.isnan(fixed_n.ravel())] = 0
        return change_n_per_s


def _converter(layout: Layout) -> SumConverter:
    found = converter(layout)
    if found is None:
        raise InputError(f"taxels.frontend is '{layout.taxels.frontend}', expected 'analogue'")
    return found
