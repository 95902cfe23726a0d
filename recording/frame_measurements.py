"""The measurements of a recording of frames alone, and when a status is due that is made of frames."""

from collections.abc import Collection, Iterable
from functools import partial
from typing import Final

from calibration.calibrator import Calibrator
from canskin.messages import GATEWAY, Measurement
from dbc.contract import Contract
from dbc.frame import Frames
from gateway.playback import Playback
from recording.step_kinds import MeasurementStep, MessageStep

#: Time after the end of frames at which those of all buses are in the file.
FRAMES_NS: Final = 1_000_000_000
#: Time between two statuses that are made of frames.
_STATUS_NS: Final = 200_000_000


class FrameMeasurements:
    """The measurements of frames alone, and the status of the gateway.

    Parameters
    ----------
    buses : collection of int
        Numbers of the buses.
    offset_ns : int
        Wall clock minus the clock of the frames.
    calibrator : Calibrator, optional
        Puts offsets into the measurements.
    """

    def __init__(
        self, contract: Contract, buses: Collection[int], offset_ns: int, calibrator: Calibrator | None
    ) -> None:
        self._offset_ns, self._pace = offset_ns, StatusPace()
        self._playback: Playback | None = None
        self._begin = partial(Playback, contract, buses, wall_offset_ns=offset_ns, calibrator=calibrator)

    def take_frames(self, bus: int, seen: Frames) -> None:
        """Take frames of a bus, in bus order."""
        if self._playback is None:
            self._playback = self._begin(start_ns=int(seen["time_ns"][0]) - FRAMES_NS)
        self._playback.feed(bus, seen)

    def advance(self, until_ns: int | None) -> Iterable[MeasurementStep | MessageStep]:
        """Yield the steps of the frames up to a time on the wall clock; None: of all frames."""
        if self._playback is None:
            return
        made: list[Measurement] = (
            self._playback.finish() if until_ns is None else self._playback.advance(until_ns - self._offset_ns)
        )
        for each in made:
            yield MeasurementStep(each.time_ns, each)
            if self._pace.is_due(each.time_ns):
                yield MessageStep(each.time_ns, GATEWAY, self._playback.status())


class StatusPace:
    """Tells when a status is due that is made of frames: every `_STATUS_NS`."""

    def __init__(self) -> None:
        self._told_ns = 0

    def is_due(self, time_ns: int) -> bool:
        """Tell whether a status is due at the time of a measurement."""
        if time_ns - self._told_ns < _STATUS_NS:
            return False
        self._told_ns = time_ns
        return True
