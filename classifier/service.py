"""The classifier's loop: measurements in, labels out."""

import time
from collections.abc import Callable
from typing import Final

import msgspec
import numpy as np

from canskin.fabric import Exchange
from canskin.messages import LABEL, MEASUREMENT, RECOGNITION, Label, Measurement, Topic
from classifier.decide import FORGET_CYCLES, Classifier
from classifier.settling import Decision
from skin.measured_sums import MeasurementReader, decode_adaptive, decode_measurement
from skin.measurement import Sbhe, places
from skin.service import StopSignal

#: Period of the check of the stop signal.
_TURN_S = 0.1
#: Measurements that wait while the classifier pauses: those of this time, and at least this number; older ones get no
#: label.
_WAITING_S: Final = 0.04
_LEAST_WAITING: Final = 4
#: Least time between two decisions on adaptive sums. The decision settles over cycles of this period.
PERIOD_S: Final = 0.01


def most_waiting(rate_hz: float) -> int:
    """Return how many measurements may wait, of `rate_hz` cycles a second."""
    return max(_LEAST_WAITING, round(_WAITING_S * rate_hz))


class ClassifierService:
    """Labels the measurements of one skin.

    Parameters
    ----------
    classifier : Classifier
    phi : Sbhe
        The Φ of the model.
    fabric : Exchange
    topic : Topic
        Of the measurements.
    wake : callable
        Called with each label.
    keeps_time : bool
        Whether measurements come as they are sampled; else labels settle over cycles, whatever their times.
    waiting : int
        Number of measurements that may wait, see `most_waiting`.

    Attributes
    ----------
    labelled : int
        Number of labelled measurements.
    """

    def __init__(
        self,
        classifier: Classifier,
        phi: Sbhe,
        fabric: Exchange,
        *,
        topic: Topic = MEASUREMENT,
        wake: Callable[[str], None] = lambda _label: None,
        keeps_time: bool = True,
        waiting: int = _LEAST_WAITING,
    ) -> None:
        self.labelled = 0
        self._keeps_time = keeps_time
        self._wake = wake
        self._classifier = classifier
        self._reader = MeasurementReader(phi, "classifier", decode_measurement)
        self._sums_of_block = np.diff(phi.starts)
        self._named_sums = phi.shape[0] if topic is RECOGNITION else 0
        self._fabric = fabric
        self._measurements = fabric.mailbox(topic, waiting)

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
                self._wake(label.label)

    def label(self, measurement: Measurement) -> Label | None:
        """Return the label of one measurement, or None when it is refused."""
        sums = self._reader.read(measurement)
        if sums is None:
            return None
        time_ns = measurement.sampled_mono_ns if self._keeps_time else None
        decision = self._classifier.decide(sums.counts, sums.valid, measurement.cycle, time_ns)
        self.labelled += 1
        label = _label_of(measurement, decision, int(self._sums_of_block[sums.valid].sum()), self.labelled)
        return msgspec.structs.replace(label, sums=self._named_sums) if self._named_sums else label


class AdaptiveClassifierService:
    """Labels the newest sums of a skin with adaptive sending, every `PERIOD_S`.

    While no measurement comes, the newest stands, so a label settles as quickly on a skin that has nothing to send. The
    gateway publishes at least every 0.1 s: after `FORGET_CYCLES` periods without a measurement nothing is labelled.

    Parameters
    ----------
    classifier : Classifier
    phi : Sbhe
        The Φ of the skin.
    classified : Sbhe
        The Φ of the model, see `classifier.coarse_sums`.
    fabric : Exchange

    Attributes
    ----------
    labelled : int
        Number of labels.
    """

    def __init__(self, classifier: Classifier, phi: Sbhe, classified: Sbhe, fabric: Exchange) -> None:
        self.labelled = 0
        self._classifier = classifier
        self._reader = MeasurementReader(phi, "classifier", decode_adaptive)
        self._places = places(phi, classified)
        self._sums_of_block = np.diff(phi.starts)
        self._fabric = fabric
        self._measurements = fabric.mailbox(MEASUREMENT, 1)
        self._newest: Measurement | None = None
        self._cycle = self._repeated = 0

    @property
    def refused(self) -> int:
        """Number of measurements with another Φ or other sizes."""
        return self._reader.refused

    def run(self, stop: StopSignal) -> None:
        """Label the newest sums until `stop` is set."""
        while not stop.is_set():
            started_s = time.monotonic()
            label = self.label(self._measurements.get(PERIOD_S))
            if label is not None:
                self._fabric.publish(LABEL, label)
            time.sleep(max(0.0, started_s + PERIOD_S - time.monotonic()))

    def label(self, measurement: Measurement | None) -> Label | None:
        """Return the label of the next period, None without one.

        Parameters
        ----------
        measurement : Measurement or None
            The newest, if one came since the last period.
        """
        self._cycle += 1
        self._repeated += 1
        if measurement is not None:
            self._newest, self._repeated = measurement, 0
        if self._newest is None or self._repeated > FORGET_CYCLES:
            return None
        sums = self._reader.read(self._newest)
        if sums is None:
            self._newest = None
            return None
        decision = self._classifier.decide(sums.counts[self._places], sums.valid, self._cycle)
        self.labelled += 1
        return _label_of(self._newest, decision, int(self._sums_of_block[sums.valid].sum()), self.labelled)


def _label_of(measurement: Measurement, decision: Decision, valid_sums: int, number: int) -> Label:
    return Label(
        cycle=measurement.cycle,
        sync_counter=measurement.sync_counter,
        sampled_mono_ns=measurement.sampled_mono_ns,
        sampled_error_ns=measurement.sampled_error_ns,
        label=decision.label,
        confidence=decision.confidence,
        valid_sums=valid_sums,
        blind=decision.blind,
        number=number,
    )
