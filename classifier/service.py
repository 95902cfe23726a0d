"""The classifier's loop: measurements in, labels out."""

import time
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.fabric import Exchange
from canskin.messages import LABEL, MEASUREMENT, Label, Measurement
from classifier.decide import Classifier
from classifier.newest_sums import FORGET_CYCLES
from classifier.settling import Decision
from classifier.used_sums import classified_phi, coarse_sums
from shell.pulse import Beat, unheard
from shell.service import StopSignal
from skin.layout import Layout
from skin.measured_sums import MeasurementReader, SteppedSums, decode_measurement, decode_stepped
from skin.phi import Phi, places

#: Period of the check of the stop signal.
_TURN_S = 0.1
#: Measurements that wait while the classifier pauses: those of this time, and at least this number; older ones get no
#: label.
_WAITING_S: Final = 0.04
_LEAST_WAITING: Final = 4
#: Least time between two decisions on steps. The decision settles over cycles of this period.
PERIOD_S: Final = 0.01
#: Name of the service.
CLASSIFIER: Final = "classifier"


def make_service(
    classifier: Classifier, layout: Layout, fabric: Exchange, instance: str = ""
) -> "ClassifierService | SteppedClassifierService":
    """Return what labels the measurements of a skin; see `_Service.instance`."""
    kind = ClassifierService if layout.sends.in_cycles else SteppedClassifierService
    service = kind(classifier, layout, fabric)
    service.instance = instance
    return service


def most_waiting(rate_hz: float) -> int:
    """Return how many measurements may wait, of `rate_hz` cycles a second."""
    return max(_LEAST_WAITING, round(_WAITING_S * rate_hz))


class _Service:
    """What both services share.

    Attributes
    ----------
    labelled : int
        Number of labels.
    instance : str
        Of its `canskin.peers.Peer`, by which a gateway names the classifier that publishes.
    """

    _reader: MeasurementReader[Any]

    def __init__(self, classifier: Classifier, phi: Phi, fabric: Exchange, *, waiting: int) -> None:
        self.labelled = 0
        self.instance = ""
        self._classifier = classifier
        self._sums_of_block = np.diff(phi.starts)
        self._fabric = fabric
        self._measurements = fabric.mailbox(MEASUREMENT, waiting)

    def _publish(self, measurement: Measurement, label: Label | None) -> None:
        """Publish a label, unless a measurement names another classifier."""
        if label is not None and measurement.names(CLASSIFIER, self.instance):
            self._fabric.publish(LABEL, label)

    def _labelled(self, measurement: Measurement, decision: Decision, valid: npt.NDArray[np.bool_]) -> Label:
        self.labelled += 1
        return Label(
            cycle=measurement.cycle,
            sync_counter=measurement.sync_counter,
            sampled_mono_ns=measurement.sampled_mono_ns,
            sampled_error_ns=measurement.sampled_error_ns,
            label=decision.label,
            confidence=decision.confidence,
            valid_sums=int(self._sums_of_block[valid].sum()),
            blind=decision.blind,
            number=self.labelled,
        )


class ClassifierService(_Service):
    """Labels the measurements of one skin, cycle by cycle.

    Parameters
    ----------
    keeps_time : bool
        Whether measurements come as they are sampled; else labels settle over cycles, whatever their times.
    """

    def __init__(
        self,
        classifier: Classifier,
        layout: Layout,
        fabric: Exchange,
        *,
        keeps_time: bool = True,
    ) -> None:
        phi = classified_phi(layout)
        super().__init__(classifier, phi, fabric, waiting=most_waiting(1 / layout.sync.period_s))
        self._reader = MeasurementReader(phi, CLASSIFIER, decode_measurement)
        self._keeps_time = keeps_time

    def run(self, stop: StopSignal, beat: Beat = unheard) -> None:
        """Label measurements until `stop` is set."""
        while not stop.is_set():
            beat(self.labelled)
            measurement = self._measurements.get(_TURN_S)
            if measurement is None:
                continue
            self._publish(measurement, self.label(measurement))

    def label(self, measurement: Measurement) -> Label | None:
        """Return the label of one measurement, or None when it is refused."""
        sums = self._reader.read(measurement)
        if sums is None:
            return None
        time_ns = measurement.sampled_mono_ns if self._keeps_time else None
        decision = self._classifier.decide(sums.counts, sums.valid, measurement.cycle, time_ns)
        return self._labelled(measurement, decision, sums.valid)

    def replay(self, measurement: Measurement, _time_ns: int) -> list[Label]:
        """Return the labels that a measurement gives in a replay."""
        label = self.label(measurement)
        return [] if label is None else [label]


class SteppedClassifierService(_Service):
    """Labels the newest sums of a skin with steps, every `PERIOD_S`.

    While no measurement comes, the newest stands, so a label settles as quickly on a skin that has nothing to send. The
    gateway publishes at least every 0.1 s: after `FORGET_CYCLES` periods without a measurement nothing is labelled.

    """

    def __init__(self, classifier: Classifier, layout: Layout, fabric: Exchange) -> None:
        super().__init__(classifier, layout.phi(), fabric, waiting=1)
        self._reader = MeasurementReader(layout.phi(), CLASSIFIER, decode_stepped)
        self._places = places(layout.phi(), coarse_sums(layout))
        self._newest: tuple[Measurement, SteppedSums] | None = None
        self._cycle = self._repeated = 0
        self._due_ns: int | None = None

    def run(self, stop: StopSignal, beat: Beat = unheard) -> None:
        """Label the newest sums until `stop` is set."""
        due_s = time.monotonic()
        while not stop.is_set():
            # By an absolute clock: a turn that is late must not delay the turns that follow. Periods that a long pause
            # swallowed are left out.
            due_s = max(due_s + PERIOD_S, time.monotonic() - FORGET_CYCLES * PERIOD_S)
            time.sleep(max(0.0, due_s - time.monotonic()))
            beat(self.labelled)
            label = self.label(self._measurements.get(0.0))
            if self._newest is not None:
                self._publish(self._newest[0], label)

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
            sums = self._reader.read(measurement)
            self._newest, self._repeated = None if sums is None else (measurement, sums), 0
        if self._newest is None or self._repeated > FORGET_CYCLES:
            return None
        newest, sums = self._newest
        decision = self._classifier.decide(sums.counts[self._places], sums.valid, self._cycle)
        return self._labelled(newest, decision, sums.valid)

    def replay(self, measurement: Measurement, time_ns: int) -> list[Label]:
        """Return the labels of the periods of a replay that have ended at `time_ns`; the first measurement has one."""
        if self._due_ns is None:
            self._due_ns = time_ns
        labels = []
        while self._due_ns <= time_ns:
            labels.append(self.label(measurement))
            self._due_ns += round(PERIOD_S * 1e9)
        return [label for label in labels if label is not None]
