"""The kinds of steps of a recorded run. Times are on the wall clock of the run."""

from dataclasses import dataclass

import msgspec

from canskin.messages import Image, Label, Measurement, Topic
from dbc.frame import Frames


@dataclass(frozen=True)
class FramesStep:
    """CAN frames of the bus with the number `bus`."""

    time_ns: int
    bus: int
    frames: Frames


@dataclass(frozen=True)
class MessageStep:
    """A message that is played as it is."""

    time_ns: int
    topic: Topic
    message: msgspec.Struct


@dataclass(frozen=True)
class MeasurementStep:
    """A measurement, of which image and label are made anew.

    Attributes
    ----------
    time_ns : int
    measurement : Measurement
    header : Measurement or None
        Number, times and proofs of the cycle in the run; None if the run had no measurements.
    recorded : Measurement or None
        The measurement of the run, if the recorder received it.
    image, label : Image or Label or None
        What was recorded of the measurement.
    makes_image, makes_label : bool
        The reconstructor, or the classifier, has used the measurement.
    """

    time_ns: int
    measurement: Measurement
    header: Measurement | None = None
    recorded: Measurement | None = None
    image: Image | None = None
    label: Label | None = None
    makes_image: bool = True
    makes_label: bool = True


Step = FramesStep | MessageStep | MeasurementStep
