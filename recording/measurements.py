"""The measurements of a recording, made anew of its frames as far as the recording has them."""

from collections import deque
from collections.abc import Collection, Iterable
from functools import partial
from typing import Any, Final

import msgspec
import numpy as np

from calibration.calibrator import Calibrator
from canskin.messages import GATEWAY, CycleMeasurement, Measurement, SteppedMeasurement
from dbc.contract import Contract
from dbc.frame import Frames
from gateway.playback import Playback, SteppedPlayback
from recording.step_kinds import MeasurementStep, MessageStep
from skin.measured_sums import used_blocks
from skin.sync_counter import next_counter

#: Time after the end of frames at which those of all buses are in the file.
FRAMES_NS: Final = 1_000_000_000
#: Time between two statuses that are made of frames.
_STATUS_NS: Final = 200_000_000
#: Most periods from the time in a measurement to its SYNC: half of the numbers of SYNC.
_FAR_CYCLES: Final = 120


class RecordedMeasurements:
    """The measurements as they were recorded."""

    #: Of the recorded measurements.
    kind: type[Measurement] = CycleMeasurement
    #: Whether a label is that of one measurement.
    have_labels = True

    def take_frames(self, bus: int, seen: Frames) -> None:
        """Take frames of a bus, in bus order."""

    def take(self, time_ns: int, recorded: Any) -> list[MeasurementStep]:
        """Take a recorded measurement; return the steps that need no further frames."""
        return [MeasurementStep(time_ns, recorded, recorded, recorded)]

    def advance(self, until_ns: int | None) -> Iterable[MeasurementStep | MessageStep]:
        """Return the steps of the frames up to a time on the wall clock; None: of all frames."""
        del until_ns
        return ()

    def played(self, step: MeasurementStep) -> Measurement:
        """Return the measurement that is played, once its recorded image and label are known."""
        return step.measurement

    def remark(self) -> str:
        """Return what could not be made, for the log."""
        return ""


class FrameMeasurements(RecordedMeasurements):
    """The measurements of frames alone, and the status of the gateway.

    Parameters
    ----------
    buses : collection of int
        Numbers of the buses.
    offset_ns : int
        Wall clock minus the clock of the frames.
    calibrator : Calibrator, optional
        Puts offsets into the measurements.
    has_run : bool
        The measurements of the run tell which blocks the gateway used.
    """

    def __init__(
        self,
        contract: Contract,
        buses: Collection[int],
        offset_ns: int,
        *,
        calibrator: Calibrator | None = None,
        has_run: bool = False,
    ) -> None:
        self._offset_ns, self._pace = offset_ns, StatusPace()
        self._playback: Playback | None = None
        self._begin = partial(
            Playback,
            contract,
            buses,
            wall_offset_ns=offset_ns,
            calibrator=calibrator,
            leaves_out_doubtful=not has_run,
        )

    def take_frames(self, bus: int, seen: Frames) -> None:
        """Take frames of a bus, in bus order."""
        if self._playback is None:
            self._playback = self._begin(start_ns=int(seen["time_ns"][0]) - FRAMES_NS)
        self._playback.feed(bus, seen)

    def advance(self, until_ns: int | None) -> Iterable[MeasurementStep | MessageStep]:
        """Return the steps of the frames up to a time on the wall clock; None: of all frames."""
        for each in self._made(until_ns):
            yield MeasurementStep(each.time_ns, each)
            if self._playback is not None and self._pace.is_due(each.time_ns):
                yield MessageStep(each.time_ns, GATEWAY, self._playback.status())

    def _made(self, until_ns: int | None) -> list[Measurement]:
        if self._playback is None:
            return []
        return self._playback.finish() if until_ns is None else self._playback.advance(until_ns - self._offset_ns)


class RunMeasurements(FrameMeasurements):
    """The measurements of the frames of a run, with the numbers, times and proofs of the recorded measurements.

    A measurement may have been lost on the way to the recorder. Then its number follows from the measurement before,
    its time from the frames, and its proofs from the image or from the measurement before.
    """

    def __init__(self, contract: Contract, buses: Collection[int], offset_ns: int) -> None:
        super().__init__(contract, buses, offset_ns, has_run=True)
        self._phi, self._period_ns = contract.phi, round(contract.layout.sync.period_s * 1e9)
        #: By counter.
        self._unpaired: dict[int, deque[CycleMeasurement]] = {}
        #: The header of the newest cycle, and the time of the newest measurement that was read.
        self._before: CycleMeasurement | None = None
        self._measured_ns = 0
        self._unmatched = 0

    def take(self, time_ns: int, recorded: CycleMeasurement) -> list[MeasurementStep]:
        """Take a recorded measurement, which waits for its frames."""
        del time_ns
        self._measured_ns = recorded.sampled_mono_ns
        self._unpaired.setdefault(recorded.sync_counter, deque()).append(recorded)
        return []

    def advance(self, until_ns: int | None) -> Iterable[MeasurementStep | MessageStep]:
        """Return the steps of the frames up to a time on the wall clock; None: of all frames."""
        for each in self._made(until_ns):
            recorded = self._recorded(each)
            header = recorded or self._header_between(each)
            if header is None:
                self._unmatched += 1
                continue
            self._before = header
            yield MeasurementStep(each.time_ns, each, header, recorded)

    def remark(self) -> str:
        """Return how many cycles are left out."""
        left_out = f"{self._unmatched} cycles have frames but no recorded measurement: they are left out"
        return left_out if self._unmatched else ""

    def played(self, step: MeasurementStep) -> Measurement:
        """Return the measurement with the sums of its frames.

        Frames do not tell which nodes were proven, nor whether the gateway read a frame in time: a block is valid if
        its frames are complete, and it was valid in the recorded measurement.
        """
        made, header = step.measurement, step.recorded or self._header_of_lost(step)
        valid = np.frombuffer(made.valid, np.uint8) & np.frombuffer(header.valid, np.uint8)
        sums = np.frombuffer(made.sums, "<i4").copy()
        sums[~self._phi.sums_of_blocks(valid != 0)] = 0
        return msgspec.structs.replace(header, sums=sums.tobytes(), valid=valid.tobytes())

    def _recorded(self, made: Measurement) -> CycleMeasurement | None:
        """Return the recorded measurement of the same SYNC."""
        candidates = self._unpaired.get(made.sync_counter, deque())
        far_ns = _FAR_CYCLES * self._period_ns
        while candidates and made.sampled_mono_ns - candidates[0].sampled_mono_ns > far_ns:
            candidates.popleft()
        if candidates and abs(made.sampled_mono_ns - candidates[0].sampled_mono_ns) <= far_ns:
            return candidates.popleft()
        return None

    def _header_between(self, made: Measurement) -> CycleMeasurement | None:
        """Return the header of a measurement that was lost between two others: one cycle after the one before.

        Its nodes count as proven as in the cycle before. None if it does not follow that cycle, or none follows.
        """
        before = self._before
        if before is None or self._measured_ns <= made.sampled_mono_ns:
            return None
        counter = next_counter(before.sync_counter)
        later_ns = made.sampled_mono_ns - before.sampled_mono_ns
        is_next = later_ns <= 2 * self._period_ns
        if made.sync_counter != counter or not is_next:
            return None
        return msgspec.structs.replace(
            before,
            cycle=before.cycle + 1,
            sync_counter=counter,
            sampled_mono_ns=made.sampled_mono_ns,
            sampled_error_ns=made.sampled_error_ns,
            bus_sampled_ns=made.bus_sampled_ns,
            sent_mono_ns=0,
        )

    def _header_of_lost(self, step: MeasurementStep) -> Measurement:
        """Return the header of a lost measurement, with what its image or its label tells."""
        header, image = step.header or step.measurement, step.image
        answer = image or step.label
        if answer is None:
            return header
        valid = np.frombuffer(header.valid, np.uint8)
        if image is not None:
            # Blocks with a sum that is not used are never valid in an image.
            is_told = used_blocks(msgspec.structs.replace(header, valid=b"\1" * self._phi.blocks), self._phi)
            valid = np.where(is_told, np.frombuffer(image.valid, np.uint8), valid)
            header = msgspec.structs.replace(header, doubtful=image.doubtful)
        return msgspec.structs.replace(
            header,
            sampled_mono_ns=answer.sampled_mono_ns,
            sampled_error_ns=answer.sampled_error_ns,
            valid=valid.tobytes(),
        )


class SteppedMeasurements(RecordedMeasurements):
    """Recorded stepped measurements with the sums of their frames: each tells which frames were in its sums."""

    kind = SteppedMeasurement
    have_labels = False  # labels have a clock of their own

    def __init__(self, contract: Contract, buses: Collection[int]) -> None:
        self._playback = SteppedPlayback(contract, buses)
        self._waiting: deque[tuple[int, SteppedMeasurement]] = deque()

    def take_frames(self, bus: int, seen: Frames) -> None:
        """Take frames of a bus, in bus order."""
        self._playback.feed(bus, seen)

    def take(self, time_ns: int, recorded: SteppedMeasurement) -> list[MeasurementStep]:
        """Take a recorded measurement, which waits for its frames if it tells which they are."""
        if not recorded.bus_sampled_ns:
            return super().take(time_ns, recorded)
        self._waiting.append((time_ns, recorded))
        return []

    def advance(self, until_ns: int | None) -> Iterable[MeasurementStep | MessageStep]:
        """Return the steps of the frames up to a time on the wall clock; None: of all frames."""
        while self._waiting and (until_ns is None or self._waiting[0][0] <= until_ns):
            time_ns, live = self._waiting.popleft()
            yield MeasurementStep(time_ns, self._playback.measured(live), live, live)

    def remark(self) -> str:
        """Return how many sums are not those of frames."""
        held = self._playback.held
        return f"{held} sums are as recorded: their frames came before the recording" if held else ""


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
