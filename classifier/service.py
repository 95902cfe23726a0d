"""The classifier's loop: one measurement in, one label out."""

import numpy as np

from classifier.decide import Classifier
from skin.fabric import Fabric
from skin.measured_sums import MeasurementReader, decode_measurement
from skin.measurement import Sbhe
from skin.messages import LABEL, MEASUREMENT, Label, Measurement
from skin.service import StopSignal

#: Period of the check of the stop signal.
_TURN_S = 0.1


class ClassifierService:
    """Labels the measurements of one skin.

    Parameters
    ----------
    classifier : Classifier
    phi : Sbhe
        The Φ of the model.
    fabric : Fabric

    Attributes
    ----------
    labelled : int
        Number of labelled measurements.
    """

    def __init__(self, classifier: Classifier, phi: Sbhe, fabric: Fabric) -> None:
        self.labelled = 0
        self._classifier = classifier
        self._reader = MeasurementReader(phi, "classifier", decode_measurement)
        self._sums_of_block = np.diff(phi.starts)
        self._fabric = fabric
        self._measurements = fabric.mailbox(MEASUREMENT)

    @property
    def refused(self) -> int:
        """Number of measurements with another Φ or other sizes."""
        return self._reader.refused

    def run(self, stop: StopSignal) -> None:
        """Label measurements until `stop` is set."""
        while not stop.is_set():
            measurement = self._measurements.get(_TURN_S)
            if measurement is None:
                continue
            label = self.label(measurement)
            if label is not None:
                self._fabric.publish(LABEL, label)

    def label(self, measurement: Measurement) -> Label | None:
        """Return the label of one measurement, or None when it is refused."""
        sums = self._reader.read(measurement)
        if sums is None:
            return None
        decision = self._classifier.decide(sums.counts, sums.valid, measurement.cycle)
        self.labelled += 1
        return Label(
            cycle=measurement.cycle,
            sync_counter=measurement.sync_counter,
            sync_mono_ns=measurement.sync_mono_ns,
            label=decision.label,
            confidence=decision.confidence,
            valid_sums=int(self._sums_of_block[sums.valid].sum()),
            blind=decision.blind,
        )
