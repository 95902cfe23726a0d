"""The sums of a skin in one process, cycle after cycle: of its nodes, for synchronous sending, or of a matrix."""

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import CycleMeasurement, Truth
from dbc.contract import Contract
from dbc.packing import packing
from nodes.electronics import Electronics
from nodes.sampler import Sampler, new_sampler
from skin.layout import Layout
from skin.matrix import MatrixPhi
from skin.sources import TaxelSource
from skin.sync_counter import next_counter

#: Time before the first touch in which the boards learn the noise of their taxels.
REST_S: Final = 0.6


class _OtherHardware:
    """Samples the touches of a source, with the noise and the ADC of the taxels, and sums them by a matrix."""

    def __init__(self, layout: Layout, phi: MatrixPhi, source: TaxelSource, seed: int) -> None:
        self._phi, self._source = phi, source
        self._electronics = Electronics(layout.taxels, seed=seed, period_s=layout.sync.period_s)
        self._step = -1
        self._truth: Truth | None = None

    def sample(self, counter: int, time_ns: int) -> npt.NDArray[np.int32]:
        """Return the sums of the next cycle."""
        self._step += 1
        frame = self._source.frame(self._step)
        counts = self._electronics.read(frame.force_n, self._step)
        self._truth = self._electronics.truth(frame, self._step, counter, time_ns)
        sums: npt.NDArray[np.int32] = self._phi.of_cycle(self._step + 1).forward(counts)
        return sums

    def take_truth(self) -> Truth | None:
        """Return the truth of the newest cycle."""
        return self._truth


class Nodes:
    """All nodes of a skin, or what makes the sums of a matrix: they sample the touches of a source once a cycle.

    Parameters
    ----------
    seed : int
        Of the sensors' noise.
    clock_ns : callable, optional
        Time of a SYNC; default: one period after another.

    Attributes
    ----------
    cycle, counter, time_ns : int
        Number, SYNC counter and time of the newest cycle; cycles count from 1.
    """

    def __init__(
        self, layout: Layout, source: TaxelSource, *, seed: int, clock_ns: Callable[[], int] | None = None
    ) -> None:
        self.cycle = self.counter = self.time_ns = 0
        phi = layout.operator()
        self._period_ns = round(layout.sync.period_s * 1e9)
        self._clock_ns = clock_ns or (lambda: self.time_ns + self._period_ns)
        self._sampler: Sampler | _OtherHardware = (
            _OtherHardware(layout, phi, source, seed)
            if isinstance(phi, MatrixPhi)
            else new_sampler(layout, phi, source, seed=seed)
        )
        self._valid, self._fingerprint = phi.has_sums.tobytes(), phi.fingerprint
        self._packing = None if isinstance(phi, MatrixPhi) else packing(layout)
        self._newest: npt.NDArray[np.int32] | None = None
        #: The sums that come in each turn.
        self._of_turn = [np.arange(phi.shape[0])]
        if layout.sync.turns > 1:
            self._of_turn = Contract.from_layout(layout).sums_of_turn

    def sample(self) -> npt.NDArray[np.int32]:
        """Return the newest of each sum after the next cycle, all of the first, ADC counts, shape (m,).

        They are rounded as boards send them.
        """
        self.cycle += 1
        self.counter = next_counter(self.counter)
        self.time_ns = self._clock_ns()
        sums = self._sampler.sample(self.counter, self.time_ns)
        if self._packing is not None:
            sums = self._packing.counts(self._packing.raw(sums))
        came = self._of_turn[(self.counter - 1) % len(self._of_turn)]
        self._newest = sums.copy() if self._newest is None else self._newest.copy()
        self._newest[came] = sums[came]
        return self._newest

    def measurement(self, counts: npt.NDArray[np.int32]) -> CycleMeasurement:
        """Return the measurement of the newest cycle, as frames carry its sums; no frame was lost."""
        usable = b"" if self._packing is None else self._packing.usable(counts)
        return CycleMeasurement(
            cycle=self.cycle,
            sync_counter=self.counter,
            sampled_mono_ns=self.time_ns,
            sums=counts.astype("<i4").tobytes(),
            valid=self._valid,
            usable=usable,
            fingerprint=self._fingerprint,
        )

    def truth(self) -> Truth:
        """Return the true forces, the sensors' signal and the label of the newest cycle."""
        truth = self._sampler.take_truth()
        if truth is None:
            raise RuntimeError("the truth of a cycle can be taken once, after its sums")
        return truth
