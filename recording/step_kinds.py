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
    image, label : Image or Label or None
        What was recorded of the measurement.
    makes_image, makes_label : bool
        The reconstructor, or the classifier, has used the measurement.
    """

    time_ns: int
    measurement: Measurement
    image: Image | None = None
    label: Label | None = None
    makes_image: bool = True
    makes_label: bool = True


Step = FramesStep | MessageStep | MeasurementStep
