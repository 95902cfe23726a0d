"""The chain of a skin in one process: the sums of its nodes, cycle after cycle, and the images and labels of sums.

For synchronous sending. `calibration.calibrator.Calibrator` goes between both where the sums have offsets.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import CycleMeasurement, Measurement, Truth
from classifier.decide import Classifier
from classifier.model import Model
from dbc.packing import packing
from nodes.sampler import new_sampler
from reconstructor.engine import Reconstructor
from skin.layout import Layout
from skin.measured_sums import MeasuredSums, decode_measurement
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


class Receivers:
    """What the services make of sums: images and labels.

    Parameters
    ----------
    model : Model, optional
        Of the labels.

    Attributes
    ----------
    phi : Sbhe
    classifier : Classifier or None
    """

    def __init__(self, layout: Layout, model: Model | None = None) -> None:
        self.phi: Final = layout.phi()
        self.classifier: Final = None if model is None else Classifier(model, self.phi)
        self._layout = layout
        self._newton_per_count = np.float32(layout.taxels.newton_per_count)

    @cached_property
    def engine(self) -> Reconstructor:
        """The solver of the images."""
        taxels = self._layout.taxels
        return Reconstructor(self.phi, taxels.rows, taxels.columns, samples=self._layout.samples_per_sync)

    def read(self, measurement: Measurement) -> MeasuredSums:
        """Return the sums of a measurement, less their offsets."""
        return decode_measurement(measurement, self.phi)

    def image(self, sums: MeasuredSums) -> npt.NDArray[np.float32]:
        """Return the image of the next cycle, newtons, shape (rows, columns)."""
        sums_n = np.multiply(sums.counts, self._newton_per_count, dtype=np.float32)
        return self.engine.solve(sums_n, sums.valid_sums)

    def label(self, sums: MeasuredSums, cycle: int) -> str:
        """Return the label of a cycle; empty if nothing touches, or without a model."""
        return "" if self.classifier is None else self.classifier.decide(sums.counts, sums.valid, cycle).label
