"""A recorded run in steps: its measurements, of frames where none were recorded, and the messages beside them."""

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec

from bandwidth.logs import of_buses, read_log
from calibration.calibrator import Calibrator
from canskin.errors import InputError
from canskin.messages import (
    GATEWAY,
    IMAGE,
    LABEL,
    MARK,
    MEASUREMENT,
    NODES,
    TRUTH,
    CycleMeasurement,
    Image,
    Label,
    Measurement,
    SteppedMeasurement,
)
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.stored_frames import from_bytes
from gateway.playback import check_named, play
from recording import is_recording
from recording.answers import Answers
from recording.frame_measurements import FRAMES_NS, FrameMeasurements, StatusPace
from recording.mcap_file import (
    FINGERPRINT,
    FRAMES,
    Entry,
    Warn,
    message_decoder,
    read_about,
    read_entries,
    read_topics,
    wall_offset_ns,
)
from recording.step_kinds import FramesStep, MeasurementStep, MessageStep, Step
from shell.service import say
from skin.layout import Layout
from skin.measured_sums import check_fingerprint, check_measurement

#: Longest time from a measurement to its image and label: the first label waits for compiled code.
_ANSWERS_NS: Final = 15_000_000_000
#: Played as they were recorded. Images and contacts, measurements and labels are made anew.
_AS_RECORDED: Final = {topic.name: topic for topic in (GATEWAY, NODES, TRUTH, MARK)}


def steps_of(
    path: Path,
    contract: Contract,
    channel: list[str] | None = None,
    *,
    every: bool = False,
    calibrator: Calibrator | None = None,
) -> Iterator[Step]:
    """Return the steps of a recording or of a CAN log, in the order of time.

    Parameters
    ----------
    channel : list of str, optional
        Of a log, see `frames_of_log`.
    every : bool
        Every measurement makes an image, whether the live one did or not.
    calibrator : Calibrator, optional
        Puts offsets into measurements that are made of frames alone; recorded ones have their own.
    """
    warn = partial(say, "replay")
    if not is_recording(path):
        return _logged(contract, frames_of_log(contract.layout, path, channel, warn), calibrator, warn)
    topics = read_topics(path)
    is_measured = MEASUREMENT.name in topics
    if calibrator is not None and is_measured:
        raise InputError(f"{path}: its measurements have the offsets of the run: leave out --calibration and --tare")
    if not has_frames(topics) and not is_measured:
        raise InputError(f"{path}: holds neither frames nor measurements: there is nothing to play")
    return _Recorded(path, contract, topics, warn, every=every, calibrator=calibrator).steps()


def has_frames(topics: Iterable[str]) -> bool:
    """Tell whether a recording with these topics has frames."""
    return any(topic.startswith(FRAMES) for topic in topics)


def frames_of_log(layout: Layout, path: Path, channel: list[str] | None, warn: Warn) -> dict[int, Frames]:
    """Return the frames of a CAN log by the number of their bus.

    Parameters
    ----------
    channel : list of str, optional
        Channels of the log, one per bus. Default: the names of the buses, else all channels in their order.
    """
    names = channel or [bus.name for bus in layout.bus]
    if len(names) > len(layout.bus):
        raise InputError(
            f"--channel: expected up to {len(layout.bus)} channels, one for each bus of the layout, got {len(names)}"
        )
    return of_buses(layout, names, read_log(path, warn), path, named_by_user=bool(channel))


def _logged(
    contract: Contract, logged: Mapping[int, Frames], calibrator: Calibrator | None, warn: Warn
) -> Iterator[Step]:
    pace = StatusPace()
    for part in play(contract, logged, calibrator):
        for bus, seen in part.frames.items():
            if len(seen):
                yield FramesStep(int(seen["time_ns"].max()), bus, seen)
        for each in part.measurements:
            yield MeasurementStep(each.time_ns, each)
            if pace.is_due(each.time_ns):
                yield MessageStep(each.time_ns, GATEWAY, part.status)
    if contract.layout.sends.in_cycles:
        check_named(part.status)
        if not part.status.cycles_complete:
            warn(f"none of {part.status.cycles} cycles is complete: another layout, a missing board, or two clocks?")


class _Recorded:
    """The steps of a recording. Frames and messages come a little after their time, so steps wait for them."""

    def __init__(
        self,
        path: Path,
        contract: Contract,
        topics: set[str],
        warn: Warn,
        *,
        every: bool,
        calibrator: Calibrator | None,
    ) -> None:
        self._path, self._contract, self._warn = path, contract, warn
        self._check_fingerprint()
        self._decoders: dict[str, Callable[[bytes], Any]] = {
            topic.name: message_decoder(path, topic) for topic in (MEASUREMENT, IMAGE, LABEL, *_AS_RECORDED.values())
        }
        self._buses = {FRAMES + bus.name: number for number, bus in enumerate(contract.layout.bus)}
        #: Makes the measurements where none were recorded.
        self._made: FrameMeasurements | None = None
        if MEASUREMENT.name not in topics:
            self._made = FrameMeasurements(contract, self._buses.values(), wall_offset_ns(path), calibrator)
        #: By time, then in the order of their coming.
        self._waiting: list[tuple[int, int, Step]] = []
        self._place = 0
        #: Times of one SYNC differ by less: the recorder has time stamps of its own.
        near_ns = round(0.5 * contract.layout.sync.period_s * 1e9)
        self._images: Answers[Image] = Answers(near_ns, is_followed=IMAGE.name in topics and not every)
        #: Stepped labels have a clock of their own.
        self._in_cycles = contract.layout.sends.in_cycles
        self._labels: Answers[Label] = Answers(near_ns, is_followed=LABEL.name in topics and self._in_cycles)

    def steps(self) -> Iterator[Step]:
        """Yield the steps in the order of time."""
        newest_ns = 0
        # What comes while the recorder stands still is recorded later: bus by bus, then the messages. So a time is over
        # when the recorder has gone on since a later one.
        passed_ns = deque((0, 0), maxlen=2)
        for entry in read_entries(self._path, self._warn):
            newest_ns = max(newest_ns, entry.time_ns)
            self._take(entry)
            if newest_ns - passed_ns[-1] >= FRAMES_NS:
                yield from self._ripe(passed_ns[0])
                passed_ns.append(newest_ns)
        yield from self._ripe(None)

    def _take(self, entry: Entry) -> None:
        if entry.topic in self._buses:
            bus, seen = self._buses[entry.topic], from_bytes(entry.data, int(entry.about["data_bytes"]))
            self._add(FramesStep(entry.time_ns, bus, seen))
            if self._made is not None:
                self._made.take_frames(bus, seen)
            return
        decode = self._decoders.get(entry.topic)
        if decode is None:
            return
        message = decode(entry.data)
        if entry.topic == MEASUREMENT.name:
            self._check(message)
            self._add(MeasurementStep(entry.time_ns, msgspec.structs.replace(message, duty="")))  # who is not here now
        elif entry.topic == IMAGE.name:
            self._images.keep(message)
        elif entry.topic == LABEL.name:
            if self._in_cycles:
                self._labels.keep(message)
        else:
            self._add(MessageStep(entry.time_ns, _AS_RECORDED[entry.topic], message))

    def _add(self, step: Step) -> None:
        self._place += 1
        heapq.heappush(self._waiting, (step.time_ns, self._place, step))

    def _ripe(self, until_ns: int | None) -> Iterator[Step]:
        """Yield the steps up to a time, with what was recorded of them; None: all steps."""
        for made in self._made.advance(until_ns) if self._made is not None else ():
            self._add(made)
        while self._waiting and (until_ns is None or self._is_ripe(self._waiting[0][2], until_ns)):
            step = heapq.heappop(self._waiting)[2]
            yield self._answered(step) if isinstance(step, MeasurementStep) else step

    def _is_ripe(self, step: Step, until_ns: int) -> bool:
        """Tell whether nothing can come any more that precedes a step or belongs to its measurement."""
        if step.time_ns > until_ns:
            return False
        if not isinstance(step, MeasurementStep) or self._made is not None or step.time_ns <= until_ns - _ANSWERS_NS:
            return True
        sync_ns = step.measurement.sampled_mono_ns
        return self._images.reaches(sync_ns) and self._labels.reaches(sync_ns)

    def _answered(self, step: MeasurementStep) -> MeasurementStep:
        """Return the step of a measurement with what was recorded of it."""
        if self._made is not None:
            return step
        image, makes_image = self._images.of(step.measurement)
        label, makes_label = self._labels.of(step.measurement)
        return replace(step, image=image, label=label, makes_image=makes_image, makes_label=makes_label)

    def _check_fingerprint(self) -> None:
        """Raise InputError if the recording is that of another Φ: its frames have other sums."""
        fingerprint = read_about(self._path).metadata.get(FINGERPRINT)
        if fingerprint is not None:
            with self._naming():
                check_fingerprint(fingerprint, self._contract.phi)

    def _check(self, measurement: Measurement) -> None:
        """Raise InputError if a measurement does not fit the layout."""
        found, expected = len(measurement.bus_sampled_ns), 8 * len(self._buses)
        with self._naming():
            check_measurement(
                measurement, self._contract.phi, CycleMeasurement if self._in_cycles else SteppedMeasurement
            )
            if found not in {0, expected}:
                raise InputError(f"bus_sampled_ns of {found} bytes, expected {expected}, or none")

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Name the recording in an InputError."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self._path}: {error}") from error
