"""A recorded run in steps: the measurements that its frames give, and the messages that were recorded beside them."""

import heapq
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from bandwidth.logs import of_buses, read_log
from calibration.calibrator import Calibrator
from canskin.errors import InputError
from canskin.messages import (
    GATEWAY,
    IMAGE,
    LABEL,
    MEASUREMENT,
    NODES,
    TRUTH,
    AdaptiveMeasurement,
    CycleMeasurement,
    Image,
    Label,
    Measurement,
    Topic,
)
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.stored_frames import from_bytes
from gateway.playback import AdaptivePlayback, Playback, play
from recording.answers import Answers
from skin.layout import RECORDING_SUFFIX
from skin.mcap_file import (
    FINGERPRINT,
    FRAMES,
    Entry,
    message_decoder,
    read_about,
    read_entries,
    read_topics,
    wall_offset_ns,
)
from skin.measured_sums import check_fingerprint, check_measurement, used_blocks
from skin.service import say
from skin.sync_counter import next_counter

#: Time after the end of frames at which those of all buses are in the file.
_FRAMES_NS: Final = 1_000_000_000
#: Longest time from a measurement to its image and label: the first label waits for compiled code.
_ANSWERS_NS: Final = 15_000_000_000
#: Time between two statuses that are made of frames.
_STATUS_NS: Final = 200_000_000
#: Most periods from the time in a measurement to its SYNC: half of the numbers of SYNC.
_FAR_CYCLES: Final = 120
#: Played as they were recorded. Images and contacts, measurements and labels are made anew.
_AS_RECORDED: Final = {topic.name: topic for topic in (GATEWAY, NODES, TRUTH)}

#: Adds a step: `_Recorded._add`.
_Add = Callable[..., None]


@dataclass(order=True)
class Step:
    """A message of the run.

    Attributes
    ----------
    time_ns : int
        On the wall clock of the run.
    topic, message : Topic, Struct
        CAN frames: topic None, message (number of the bus, frames).
    recorded : Measurement or None
        Of a measurement: the recorded one, or that before if it was lost.
    was_lost : bool
        The measurement came not to the recorder: its number follows from the measurement before, its time from frames.
    image, label : Image or Label or None
        Of a measurement: what was recorded of it.
    makes_image, makes_label : bool
        Of a measurement: the reconstructor, or the classifier, has used it.
    """

    time_ns: int
    place: int
    topic: Topic | None = field(compare=False)
    message: Any = field(compare=False)
    recorded: Measurement | None = field(default=None, compare=False)
    was_lost: bool = field(default=False, compare=False)
    image: Image | None = field(default=None, compare=False)
    label: Label | None = field(default=None, compare=False)
    makes_image: bool = field(default=True, compare=False)
    makes_label: bool = field(default=True, compare=False)


def steps_of(
    path: Path,
    contract: Contract,
    channels: list[str],
    *,
    named_by_user: bool,
    every: bool = False,
    calibrator: Calibrator | None = None,
) -> Iterator[Step]:
    """Yield the steps of a recording or of a CAN log, in the order of time.

    Parameters
    ----------
    path : pathlib.Path
    contract : Contract
    channels : list of str
        Of a log: one per bus.
    named_by_user : bool
        The channels are not the names of the buses.
    every : bool
        Every measurement makes an image, whether the live one did or not.
    calibrator : Calibrator, optional
        Puts offsets into measurements that are made of frames alone; recorded ones have their own.

    Raises
    ------
    InputError
        If the file cannot be read, or holds nothing to play, or what it holds does not fit the layout.
    """
    if path.suffix.lower() == RECORDING_SUFFIX:
        topics = read_topics(path)
        if calibrator is not None and MEASUREMENT.name in topics:
            raise InputError(
                f"{path}: its measurements have the offsets of the run: leave out --calibration and --tare"
            )
        if not any(topic.startswith(FRAMES) for topic in topics) and MEASUREMENT.name not in topics:
            raise InputError(f"{path}: holds neither frames nor measurements: there is nothing to play")
        yield from _Recorded(path, contract, topics, every=every, calibrator=calibrator).steps()
    else:
        yield from _logged(path, contract, channels, calibrator, named_by_user=named_by_user)


def _logged(
    path: Path, contract: Contract, channels: list[str], calibrator: Calibrator | None, *, named_by_user: bool
) -> Iterator[Step]:
    logged = of_buses(contract.layout, channels, read_log(path, _warn), path, named_by_user=named_by_user)
    status_ns = place = 0
    for part in play(contract, logged, calibrator):
        for bus, seen in part.frames.items():
            if len(seen):
                yield Step(int(seen["time_ns"].max()), place, None, (bus, seen))
        for each in part.measurements:
            place += 1
            yield Step(each.time_ns, place, MEASUREMENT, each)
            if each.time_ns - status_ns >= _STATUS_NS:
                status_ns = each.time_ns
                yield Step(each.time_ns, place, GATEWAY, part.status)


class _Recorded:
    """The steps of a recording. Frames and messages come a little after their time, so steps wait for them."""

    def __init__(
        self, path: Path, contract: Contract, topics: set[str], *, every: bool, calibrator: Calibrator | None
    ) -> None:
        self._path, self._contract = path, contract
        self._check_fingerprint()
        self._decoders: dict[str, Callable[[bytes], Any]] = {
            topic.name: message_decoder(path, topic) for topic in (MEASUREMENT, IMAGE, LABEL, *_AS_RECORDED.values())
        }
        self._waiting: list[Step] = []
        self._place = 0
        self._measurements = _measurements_of(path, contract, topics, self._add, calibrator)
        near_ns = _near_ns(contract)
        self._images: Answers[Image] = Answers(near_ns, is_followed=IMAGE.name in topics and not every)
        has_labels = LABEL.name in topics and self._measurements.have_labels
        self._labels: Answers[Label] = Answers(near_ns, is_followed=has_labels)
        self._buses = {FRAMES + bus.name: number for number, bus in enumerate(contract.layout.bus)}

    def steps(self) -> Iterator[Step]:
        """Yield the steps in the order of time."""
        newest_ns = advanced_ns = 0
        for entry in read_entries(self._path, _warn):
            newest_ns = max(newest_ns, entry.time_ns)
            self._take(entry)
            if newest_ns - advanced_ns >= _FRAMES_NS:
                advanced_ns = newest_ns
                self._measurements.advance(newest_ns - _FRAMES_NS)
                yield from self._ripe(newest_ns - _FRAMES_NS)
        self._measurements.advance(None)
        yield from self._ripe(None)
        if self._measurements.limit:
            say("replay", self._measurements.limit)

    def _is_ripe(self, step: Step, until_ns: int) -> bool:
        """Tell whether nothing can come any more that precedes a step or belongs to its measurement."""
        if step.time_ns > until_ns:
            return False
        if step.recorded is None or step.time_ns <= until_ns - _ANSWERS_NS:
            return True
        sync_ns = step.recorded.sampled_mono_ns
        return self._images.reaches(sync_ns) and self._labels.reaches(sync_ns)

    def _take(self, entry: Entry) -> None:
        if entry.topic in self._buses:
            bus, seen = self._buses[entry.topic], from_bytes(entry.data, int(entry.about["data_bytes"]))
            self._add(entry.time_ns, None, (bus, seen))
            self._measurements.feed(bus, seen)
            return
        decode = self._decoders.get(entry.topic)
        if decode is None:
            return
        message = decode(entry.data)
        if entry.topic == MEASUREMENT.name:
            self._check(message)
            self._measurements.keep(entry.time_ns, message)
        elif entry.topic == IMAGE.name:
            self._images.keep(message)
        elif entry.topic == LABEL.name:
            if self._measurements.have_labels:
                self._labels.keep(message)
        else:
            self._add(entry.time_ns, _AS_RECORDED[entry.topic], message)

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
            check_measurement(measurement, self._contract.phi, self._measurements.kind)
            if found not in {0, expected}:
                raise InputError(f"bus_sampled_ns of {found} bytes, expected {expected}, or none")

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Name the recording in an InputError."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self._path}: {error}") from error

    def _add(
        self,
        time_ns: int,
        topic: Topic | None,
        message: Any,
        recorded: Measurement | None = None,
        *,
        was_lost: bool = False,
    ) -> None:
        self._place += 1
        heapq.heappush(self._waiting, Step(time_ns, self._place, topic, message, recorded, was_lost))

    def _ripe(self, until_ns: int | None) -> Iterator[Step]:
        """Yield the steps up to a time, with what was recorded of them."""
        while self._waiting and (until_ns is None or self._is_ripe(self._waiting[0], until_ns)):
            step = heapq.heappop(self._waiting)
            if step.recorded is not None:
                step.image, step.makes_image = self._images.of(step.recorded)
                step.label, step.makes_label = self._labels.of(step.recorded)
                step.message = self._measurements.as_live(step, step.recorded)
            yield step


class _AsRecorded:
    """Measurements of cycles without frames: each is played as it was recorded."""

    #: Of the recorded measurements.
    kind: type[Measurement] = CycleMeasurement
    #: Whether a label is that of one measurement.
    have_labels = True

    def __init__(self, add: _Add) -> None:
        self._add = add

    def feed(self, bus: int, seen: Frames) -> None:
        """Take frames of a bus."""

    def keep(self, time_ns: int, recorded: Any) -> None:
        """Take a recorded measurement."""
        self._add(time_ns, MEASUREMENT, recorded, recorded)

    def advance(self, until_ns: int | None) -> None:
        """Make the measurements of the frames up to a time on the wall clock; None: of all frames."""

    def as_live(self, step: Step, _recorded: Measurement) -> Any:
        """Return the measurement of a step with what its recorded measurement, image and label tell."""
        return step.message

    @property
    def limit(self) -> str:
        """In what the replay is not the run; empty if it is."""
        return ""


class _OfAdaptive(_AsRecorded):
    """Recorded adaptive measurements, which tell their frames."""

    kind = AdaptiveMeasurement
    have_labels = False  # labels have a clock of their own

    def __init__(self, add: _Add, contract: Contract) -> None:
        super().__init__(add)
        self._playback = AdaptivePlayback(contract, range(len(contract.layout.bus)))
        self._kept: deque[tuple[int, AdaptiveMeasurement]] = deque()

    def feed(self, bus: int, seen: Frames) -> None:
        """See `_AsRecorded`."""
        self._playback.feed(bus, seen)

    def keep(self, time_ns: int, recorded: AdaptiveMeasurement) -> None:
        """See `_AsRecorded`."""
        if recorded.bus_sampled_ns:
            self._kept.append((time_ns, recorded))
        else:
            super().keep(time_ns, recorded)

    def advance(self, until_ns: int | None) -> None:
        """See `_AsRecorded`."""
        while self._kept and (until_ns is None or self._kept[0][0] <= until_ns):
            time_ns, live = self._kept.popleft()
            self._add(time_ns, MEASUREMENT, self._playback.measured(live), live)

    @property
    def limit(self) -> str:
        """See `_AsRecorded`."""
        held = self._playback.held
        return f"{held} sums are as recorded: their frames came before the recording" if held else ""


class _OfFrames(_AsRecorded):
    """Measurements that frames give, each with the recorded measurement of its SYNC if there are any."""

    def __init__(
        self,
        add: _Add,
        contract: Contract,
        offset_ns: int,
        start: Callable[[int], Playback],
        *,
        is_measured: bool,
    ) -> None:
        super().__init__(add)
        self._contract, self._offset_ns = contract, offset_ns
        self._start, self._is_measured = start, is_measured
        #: Without counter a SYNC is known by its time alone.
        self._is_counted = contract.sync_overflow > 0
        self._far_ns = 2 * _FAR_CYCLES * _near_ns(contract) if self._is_counted else _near_ns(contract)
        self._playback: Playback | None = None
        self._unpaired: dict[int, deque[CycleMeasurement]] = {}
        #: The measurement that was played last, and the time of the newest that was read.
        self._before: CycleMeasurement | None = None
        self._measured_ns = 0
        self._unmatched = self._status_ns = 0

    def feed(self, bus: int, seen: Frames) -> None:
        """See `_AsRecorded`."""
        if self._playback is None:
            self._playback = self._start(int(seen["time_ns"][0]) - _FRAMES_NS)
        self._playback.feed(bus, seen)

    def keep(self, _time_ns: int, recorded: CycleMeasurement) -> None:
        """See `_AsRecorded`."""
        self._measured_ns = recorded.sampled_mono_ns
        self._unpaired.setdefault(self._counter(recorded), deque()).append(recorded)

    def advance(self, until_ns: int | None) -> None:
        """See `_AsRecorded`."""
        playback = self._playback
        if playback is None:
            return
        made = playback.finish() if until_ns is None else playback.advance(until_ns - self._offset_ns)
        for each in made:
            if not self._is_measured:
                self._add(each.time_ns, MEASUREMENT, each)
                if each.time_ns - self._status_ns >= _STATUS_NS:
                    self._status_ns = each.time_ns
                    self._add(each.time_ns, GATEWAY, playback.status())
                continue
            recorded = self._recorded(each)
            was_lost = recorded is None
            if recorded is None:
                recorded = self._between(each)
            if recorded is None:
                self._unmatched += 1
                continue
            self._before = recorded
            self._add(each.time_ns, MEASUREMENT, each, recorded, was_lost=was_lost)

    def as_live(self, step: Step, recorded: Measurement) -> Measurement:
        """Return a measurement made of frames with the number, the times and the proofs of the recorded measurement.

        Frames do not tell which nodes were proven, nor whether the gateway read a frame in time: a block is valid if
        its frames are complete, and it was valid in the recorded measurement. The sums are those of the frames.
        """
        made: Measurement = step.message
        known = self._header_of_lost(step, recorded) if step.was_lost else recorded
        valid = np.frombuffer(made.valid, np.uint8) & np.frombuffer(known.valid, np.uint8)
        sums = np.frombuffer(made.sums, "<i4").copy()
        sums[~self._contract.phi.sums_of_blocks(valid != 0)] = 0
        return msgspec.structs.replace(known, sums=sums.tobytes(), valid=valid.tobytes(), fingerprint=made.fingerprint)

    @property
    def limit(self) -> str:
        """See `_AsRecorded`."""
        left_out = f"{self._unmatched} cycles have frames but no recorded measurement: they are left out"
        return left_out if self._unmatched else ""

    def _recorded(self, made: Measurement) -> CycleMeasurement | None:
        """Return the recorded measurement of the same SYNC."""
        candidates = self._unpaired.get(self._counter(made), deque())
        while candidates and made.sampled_mono_ns - candidates[0].sampled_mono_ns > self._far_ns:
            candidates.popleft()
        if candidates and abs(made.sampled_mono_ns - candidates[0].sampled_mono_ns) <= self._far_ns:
            return candidates.popleft()
        return None

    def _counter(self, measurement: Measurement) -> int:
        """Return the counter by which a SYNC is known; 0 if its frame has none."""
        return measurement.sync_counter if self._is_counted else 0

    def _between(self, made: Measurement) -> CycleMeasurement | None:
        """Return the header of a measurement that was lost on the way to the recorder: one cycle after another.

        Its nodes count as proven as in the cycle before. None if it does not follow that cycle, or none follows.
        """
        before = self._before
        if before is None or self._measured_ns <= made.sampled_mono_ns:
            return None
        later_ns = made.sampled_mono_ns - before.sampled_mono_ns
        counter = next_counter(before.sync_counter)
        if (self._is_counted and made.sync_counter != counter) or later_ns > 4 * _near_ns(self._contract):
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

    def _header_of_lost(self, step: Step, header: Measurement) -> Measurement:
        """Return the header of a lost measurement, with what its image or its label tells."""
        answer = step.image or step.label
        if answer is None:
            return header
        phi, valid = self._contract.phi, np.frombuffer(header.valid, np.uint8)
        if step.image is not None:
            # Blocks with a sum that is not used are never valid in an image.
            is_told = used_blocks(msgspec.structs.replace(header, valid=b"\1" * phi.blocks), phi)
            valid = np.where(is_told, np.frombuffer(step.image.valid, np.uint8), valid)
            header = msgspec.structs.replace(header, doubtful=step.image.doubtful)
        return msgspec.structs.replace(
            header,
            sampled_mono_ns=answer.sampled_mono_ns,
            sampled_error_ns=answer.sampled_error_ns,
            valid=valid.tobytes(),
        )


def _measurements_of(
    path: Path, contract: Contract, topics: set[str], add: _Add, calibrator: Calibrator | None
) -> _AsRecorded:
    """Return what gives the measurements of a recording."""
    is_measured, buses = MEASUREMENT.name in topics, range(len(contract.layout.bus))
    if is_measured and not contract.layout.sends.in_cycles:
        return _OfAdaptive(add, contract)
    if not any(topic.startswith(FRAMES) for topic in topics):
        return _AsRecorded(add)
    offset_ns = wall_offset_ns(path)

    start = partial(
        Playback, contract, buses, wall_offset_ns=offset_ns, calibrator=calibrator, leaves_out_doubtful=not is_measured
    )
    return _OfFrames(add, contract, offset_ns, start, is_measured=is_measured)


def _near_ns(contract: Contract) -> int:
    """Return half a period: times of one SYNC differ by less, because the recorder has time stamps of its own."""
    return round(0.5 * contract.layout.sync.period_s * 1e9)


def _warn(line: str) -> None:
    say("replay", line)
