"""The classifier's loop: one measurement in, one label out."""

import numpy as np

from classifier.decide import Classifier
from skin.fabric import Fabric
from skin.measurement import Sbhe
from skin.messages import LABEL, MEASUREMENT, Label, Measurement
from skin.service import StopSignal, say

#: Longest wait before looking whether to stop.
_TURN_S = 0.1


class ClassifierService:
    """Labels the measurements of one skin.

    Parameters
    ----------
    classifier : Classifier
    phi : Sbhe
        The Φ its model was trained for.
    fabric : Fabric

    Attributes
    ----------
    labelled, refused : int
        Measurements labelled, and those of another Φ or of a wrong size.
    """

    def __init__(self, classifier: Classifier, phi: Sbhe, fabric: Fabric) -> None:
        self.labelled = 0
        self.refused = 0
        self._classifier = classifier
        self._fingerprint = phi.fingerprint
        self._sums, self._blocks = phi.shape[0], phi.blocks
        self._sums_of_block = np.diff(phi.starts)
        self._fabric = fabric
        self._measurements = fabric.mailbox(MEASUREMENT)

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
        if not self._fits(measurement):
            return None
        valid = np.frombuffer(measurement.valid, np.uint8)
        decision = self._classifier.decide(np.frombuffer(measurement.sums, "<i4"), valid != 0, measurement.cycle)
        self.labelled += 1
        return Label(
            cycle=measurement.cycle,
            sync_counter=measurement.sync_counter,
            sync_mono_ns=measurement.sync_mono_ns,
            label=decision.label,
            confidence=decision.confidence,
            valid_sums=int(self._sums_of_block[valid != 0].sum()),
            blind=decision.blind,
        )

    def _fits(self, measurement: Measurement) -> bool:
        if (
            measurement.fingerprint == self._fingerprint
            and len(measurement.sums) == 4 * self._sums
            and len(measurement.valid) == self._blocks
        ):
            return True
        if not self.refused:
            say(
                "classifier",
                f"refusing measurements of Φ {measurement.fingerprint} with {len(measurement.sums) // 4} sums:"
                f" the model is for Φ {self._fingerprint} with {self._sums}; give both ends the same --layout",
            )
        self.refused += 1
        return False
