"""Replay of a run: its measurements go through the reconstructor and the classifier, one after the other."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import msgspec

from canskin.fabric import Exchange, Mailbox
from canskin.messages import LABEL, MEASUREMENT, Image, Label, Topic
from classifier.service import ClassifierService, SteppedClassifierService
from reconstructor.imaging import Imager
from reconstructor.service import ReconstructorService
from recording.answers import largest_difference_n, same_pixels
from recording.sinks import Sink
from recording.step_kinds import FramesStep, MeasurementStep, MessageStep, Step
from shell.service import StopSignal
from skin.layout import Layout

#: Confidences that differ by less are equal: their sums depend on the labels since the classifier's start.
CONFIDENCE_ERROR: Final = 1e-9
#: Field of a label whose difference is one of the model.
LABEL_NAME: Final = "label"
#: What else of a label may differ.
CONFIDENCE: Final = "confidence"
#: What differs, in newtons.
PIXELS: Final = "forces (N)"


#: How a message differs from the recorded one: what, and the amount of numbers. Empty: it is equal.
Difference = dict[str, float]


@dataclass
class Agreement:
    """How many messages of a kind were made, had a recorded one to be compared with, and were equal to it.

    Attributes
    ----------
    last_different : int
        Messages compared up to the last that differs.
    differs : dict of str to float
        What differs, and the largest amount.
    """

    made: int = 0
    compared: int = 0
    equal: int = 0
    last_different: int = 0
    differs: Difference = field(default_factory=dict)

    def add(self, difference: Difference | None) -> None:
        """Count a message; None if nothing was recorded of it."""
        self.made += 1
        if difference is None:
            return
        self.compared += 1
        self.equal += not difference
        if difference:
            self.last_different = self.compared
        for what, amount in difference.items():
            self.differs[what] = max(amount, self.differs.get(what, 0.0))

    def verdict(self) -> str:
        """Tell "equal", or up to which message they differ and in what; empty without comparison."""
        if not self.compared:
            return ""
        what = ", ".join(f"{name} by up to {most:.2g}" if most else name for name, most in self.differs.items())
        if not self.differs:
            return "equal"
        return f"different up to number {self.last_different}: {what}"


@dataclass
class Report:
    """Result of a replay.

    Attributes
    ----------
    measurements, measured : int
        Measurements, and those with a valid block.
    images, labels : Agreement
        Images are compared by their pixels (`recording.answers.same_pixels`), validity and number of sums; labels by
        all but their number.
    """

    measurements: int = 0
    measured: int = 0
    images: Agreement = field(default_factory=Agreement)
    labels: Agreement = field(default_factory=Agreement)

    def lines(self) -> list[str]:
        """Return the result in words."""
        told = [f"{self.measurements} measurements"] if self.measurements else []
        for name in ("images", "labels"):
            one: Agreement = getattr(self, name)
            if one.made:
                of_recorded = f", {one.equal} of {one.compared} equal to the recorded" if one.compared else ""
                names = "all names equal; " if name == "labels" and one.differs.keys() == {CONFIDENCE} else ""
                told.append(f"{one.made} {name}{of_recorded}{one.verdict() and ': '}{names}{one.verdict()}")
        if self.images.differs or self.labels.differs:
            told.append("solver, temporal filter and classifier begin anew where the recording begins")
        if LABEL_NAME in self.labels.differs:
            told.append("other names: where the run had another model or other objects, give the model with --model")
        return told


class Replay:
    """Runs steps through the services, in one process and in their order, so that every run gives the same.

    A `canskin.fabric.Exchange` for its services.

    Parameters
    ----------
    make_classifier : callable, optional
        Returns the classifier's service on this exchange; default: nothing is labelled.
    receivers : sequence of callable
        Each receives the messages, with their topics.
    sink : Sink, optional
        Receives the messages and the frames, whose clock is `offset_ns` behind the wall clock.
    """

    def __init__(
        self,
        layout: Layout,
        imager: Imager,
        make_classifier: Callable[[Exchange], ClassifierService | SteppedClassifierService] | None = None,
        *,
        receivers: Sequence[Callable[[Topic, Any], None]] = (),
        sink: Sink | None = None,
        offset_ns: int = 0,
    ) -> None:
        self.report = Report()
        self._receivers, self._sink, self._offset_ns = receivers, sink, offset_ns
        timer = time.perf_counter if sink is None else lambda: 0.0  # the same file again gives the same bytes
        self._reconstructor = ReconstructorService(layout, imager, self, clock_ns=self._published_ns, timer=timer)
        self._classifier = None if make_classifier is None else make_classifier(self)
        self._force_max_n = layout.taxels.force_max_n
        self._now_ns = 0
        self._measured: MeasurementStep | None = None

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        """Pass a message to the receivers and to the sink, with the time of its step."""
        if self._measured is not None and isinstance(message, Image):
            self.report.images.add(_image_difference(message, self._measured.image, self._force_max_n))
        for receive in self._receivers:
            receive(topic, message)
        if self._sink is not None:
            self._sink.message(topic, self._now_ns, msgspec.msgpack.encode(message))

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        """Return a mailbox that stays empty: services are called."""
        del topic
        return Mailbox(depth)

    def run(self, steps: Iterable[Step], stop: StopSignal, speed: float) -> None:
        """Play the steps; `speed` is the time of the run per time that passes, infinite for no waiting."""
        started_s, first_ns = time.monotonic(), None
        for step in steps:
            if first_ns is None:
                first_ns = step.time_ns
            left_s = started_s + (step.time_ns - first_ns) * 1e-9 / speed - time.monotonic()
            if stop.is_set() or (left_s > 0 and stop.wait(left_s)):
                return
            self.take(step)

    def take(self, step: Step) -> None:
        """Play one step."""
        self._measured, self._now_ns = None, step.time_ns
        match step:
            case FramesStep(time_ns, bus, seen):
                if self._sink is not None:
                    self._sink.frames(bus, seen, time_ns, self._offset_ns)
            case MessageStep(_, topic, message):
                self.publish(topic, message)
            case MeasurementStep():
                self._measured = step
                self._take_measurement(step)

    def _take_measurement(self, step: MeasurementStep) -> None:
        self.publish(MEASUREMENT, step.measurement)
        self.report.measured += any(step.measurement.valid)
        self.report.measurements += 1
        if step.makes_image:
            self._reconstructor.take(step.measurement)
        if self._classifier is None or not step.makes_label:
            return
        for label in self._classifier.replay(step.measurement, step.time_ns):
            self.report.labels.add(_label_difference(label, step.label))
            self.publish(LABEL, label)

    def _published_ns(self) -> int:
        """Return when the image was published live; without a live image, the time of its SYNC."""
        if self._measured is None:
            return self._now_ns
        image = self._measured.image
        return self._measured.measurement.sampled_mono_ns if image is None else image.published_mono_ns


def _fields_that_differ(made: msgspec.Struct, recorded: msgspec.Struct) -> Difference:
    return {name: 0.0 for name in made.__struct_fields__ if getattr(made, name) != getattr(recorded, name, None)}


def _label_difference(made: Label, recorded: Label | None) -> Difference | None:
    """Compare labels of one instant; numbers are not compared: a classifier that is started counts from 1."""
    if recorded is None:
        return None
    error = abs(made.confidence - recorded.confidence)
    same = msgspec.structs.replace(made, confidence=recorded.confidence, number=recorded.number)
    return _fields_that_differ(same, recorded) | ({CONFIDENCE: error} if error >= CONFIDENCE_ERROR else {})


def _image_difference(made: Image, recorded: Image | None, force_max_n: float) -> Difference | None:
    if recorded is None:
        return None
    found: Difference = {} if made.valid == recorded.valid else {"validity": 0.0}
    if made.valid_sums != recorded.valid_sums:
        found["valid_sums"] = float(abs(made.valid_sums - recorded.valid_sums))
    if not same_pixels(made.pixels, recorded.pixels, force_max_n):
        found[PIXELS] = largest_difference_n(made.pixels, recorded.pixels)
    return found
