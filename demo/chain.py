"""The sums of a skin's nodes in one process, cycle after cycle; for synchronous sending."""

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import CycleMeasurement, Truth
from dbc.packing import packing
from nodes.sampler import new_sampler
from skin.layout import Layout
from skin.sources import TaxelSource
from skin.sync_counter import next_counter

#: Time before the first touch in which the boards learn the noise of their taxels.
REST_S: Final = 0.6


class Nodes:
    """All nodes of a skin: they sample the touches of a source once a cycle.

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
        phi = layout.phi()
        self._period_ns = round(layout.sync.period_s * 1e9)
        self._clock_ns = clock_ns or (lambda: self.time_ns + self._period_ns)
        self._sampler = new_sampler(layout, phi, source, seed=seed)
        self._valid, self._fingerprint = phi.has_sums.tobytes(), phi.fingerprint
        self._packing = packing(layout)

    def sample(self) -> npt.NDArray[np.int32]:
        """Return the sums of the next cycle, ADC counts, shape (m,)."""
        self.cycle += 1
        self.counter = next_counter(self.counter)
        self.time_ns = self._clock_ns()
        return self._sampler.sample(self.counter, self.time_ns)

    def measurement(self, counts: npt.NDArray[np.int32]) -> CycleMeasurement:
        """Return the measurement of the newest cycle; no frame was lost."""
        return CycleMeasurement(
            cycle=self.cycle,
            sync_counter=self.counter,
            sampled_mono_ns=self.time_ns,
            sums=counts.astype("<i4").tobytes(),
            valid=self._valid,
            usable=self._packing.usable(counts),
            fingerprint=self._fingerprint,
        )

    def truth(self) -> Truth:
        """Return the true forces, the sensors' signal and the label of the newest cycle."""
        truth = self._sampler.take_truth()
        if truth is None:
            raise RuntimeError("the truth of a cycle can be taken once, after its sums")
        return truth
