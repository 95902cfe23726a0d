"""A recorded run in steps: the measurements that its frames give, and the messages that were recorded beside them."""

import heapq
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from bandwidth.logs import of_buses, read_log
from calibration.calibrator import Calibrator
from canskin.errors import InputError
from canskin.messages import GATEWAY, IMAGE, LABEL, MEASUREMENT, NODES, TRUTH, Image, Label, Measurement, Topic
from dbc.contract import Contract
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
from skin.measured_sums import check_adaptive, check_fingerprint, check_measurement, used_blocks
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
        self._calibrator = calibrator
        self._path, self._contract = path, contract
        self._check_fingerprint()
        self._decoders: dict[str, Callable[[bytes], Any]] = {
            topic.name: message_decoder(path, topic) for topic in (MEASUREMENT, IMAGE, LABEL, *_AS_RECORDED.values())
        }
        self._measures = MEASUREMENT.name in topics
        has_frames = any(topic.startswith(FRAMES) for topic in topics)
        #: Which frames are in an adaptive measurement, the measurement tells; frames alone do not.
        tells_frames = contract.layout.sending == "adaptive" and self._measures
        self._uses_frames = has_frames and not tells_frames
        self._adaptive = AdaptivePlayback(contract, range(len(contract.layout.bus))) if tells_frames else None
        self._of_frames: deque[tuple[int, Measurement]] = deque()
        #: Without counter a SYNC is known by its time alone.
        self._is_counted = contract.sync_overflow > 0
        self._far_ns = round((_FAR_CYCLES if self._is_counted else 0.5) * contract.layout.sync.period_s * 1e9)
        #: Times of one SYNC differ by less: the recorder has time stamps of its own.
        self._near_ns = round(0.5 * contract.layout.sync.period_s * 1e9)
        self._playback: Playback | None = None
        self._waiting: list[Step] = []
        self._unpaired: dict[int, deque[Measurement]] = {}
        self._images: Answers[Image] = Answers(self._near_ns, is_followed=IMAGE.name in topics and not every)
        self._labels: Answers[Label] = Answers(self._near_ns, is_followed=LABEL.name in topics)
        #: The measurement that was played last, and the time of the newest that was read.
        self._before: Measurement | None = None
        self._measured_ns = 0
        self._buses = {FRAMES + bus.name: number for number, bus in enumerate(contract.layout.bus)}
        self._place = self._unmatched = 0
        self._offset_ns = wall_offset_ns(path)
        self._status_ns = 0

    def steps(self) -> Iterator[Step]:
        """Yield the steps in the order of time."""
        newest_ns = advanced_ns = 0
        for entry in read_entries(self._path, _warn):
            newest_ns = max(newest_ns, entry.time_ns)
            self._take(entry)
            if newest_ns - advanced_ns >= _FRAMES_NS:
                advanced_ns = newest_ns
                self._advance(newest_ns - _FRAMES_NS)
                yield from self._ripe(newest_ns - _FRAMES_NS)
        self._advance(None)
        yield from self._ripe(None)
        if self._unmatched:
            say("replay", f"{self._unmatched} cycles have frames but no recorded measurement: they are left out")
        if self._adaptive is not None and self._adaptive.held:
            say("replay", f"{self._adaptive.held} sums are as recorded: their frames came before the recording")

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
            self._take_frames(entry)
            return
        decode = self._decoders.get(entry.topic)
        if decode is None:
            return
        message = decode(entry.data)
        if entry.topic == MEASUREMENT.name:
            self._check(message)
            if self._uses_frames:
                self._measured_ns = message.sampled_mono_ns
                self._unpaired.setdefault(self._counter(message), deque()).append(message)
            elif self._adaptive is not None and message.bus_sampled_ns:
                self._of_frames.append((entry.time_ns, message))
            else:
                self._add(entry.time_ns, MEASUREMENT, message, message)
        elif entry.topic == IMAGE.name:
            self._images.keep(message)
        elif entry.topic == LABEL.name:
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
        check = check_measurement if self._adaptive is None else check_adaptive
        found, expected = len(measurement.bus_sampled_ns), 8 * len(self._buses)
        with self._naming():
            check(measurement, self._contract.phi)
            if found not in {0, expected}:
                raise InputError(f"bus_sampled_ns of {found} bytes, expected {expected}, or none")

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Name the recording in an InputError."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self._path}: {error}") from error

    def _take_frames(self, entry: Entry) -> None:
        seen = from_bytes(entry.data, int(entry.about["data_bytes"]))
        self._add(entry.time_ns, None, (self._buses[entry.topic], seen))
        if self._adaptive is not None:
            self._adaptive.feed(self._buses[entry.topic], seen)
        if not self._uses_frames:
            return
        if self._playback is None:
            start_ns = int(seen["time_ns"][0]) - _FRAMES_NS
            self._playback = Playback(
                self._contract,
                self._buses.values(),
                start_ns,
                self._offset_ns,
                calibrator=self._calibrator,
                leaves_out_doubtful=not self._measures,
            )
        self._playback.feed(self._buses[entry.topic], seen)

    def _advance(self, until_ns: int | None) -> None:
        """Make the measurements of the frames up to a time on the wall clock."""
        while self._adaptive is not None and self._of_frames:
            time_ns, live = self._of_frames[0]
            if until_ns is not None and time_ns > until_ns:
                break
            self._of_frames.popleft()
            self._add(time_ns, MEASUREMENT, self._adaptive.measured(live), live)
        playback = self._playback
        if playback is None:
            return
        made = playback.finish() if until_ns is None else playback.advance(until_ns - self._offset_ns)
        for each in made:
            if not self._measures:
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

    def _recorded(self, made: Measurement) -> Measurement | None:
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

    def _between(self, made: Measurement) -> Measurement | None:
        """Return the header of a measurement that was lost on the way to the recorder: one cycle after another.

        Its nodes count as proven as in the cycle before. None if it does not follow that cycle, or none follows.
        """
        before = self._before
        if before is None or self._measured_ns <= made.sampled_mono_ns:
            return None
        period_ns = round(self._contract.layout.sync.period_s * 1e9)
        later_ns = made.sampled_mono_ns - before.sampled_mono_ns
        counter = next_counter(before.sync_counter)
        if (self._is_counted and made.sync_counter != counter) or later_ns > 2 * period_ns:
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
                if self._uses_frames:
                    known = self._header_of_lost(step) if step.was_lost else step.recorded
                    step.message = as_live(step.message, known, self._contract)
            yield step

    def _header_of_lost(self, step: Step) -> Measurement:
        """Return the header of a lost measurement, with what its image or its label tells."""
        header: Measurement = step.message if step.recorded is None else step.recorded
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


def as_live(made: Measurement, recorded: Measurement, contract: Contract) -> Measurement:
    """Return a measurement made of frames with the number, the times and the proofs of the recorded measurement.

    Frames do not tell which nodes were proven, nor whether the gateway read a frame in time: a block is valid if its
    frames are complete, and it was valid in the recorded measurement. The sums are those of the frames.
    """
    valid = np.frombuffer(made.valid, np.uint8) & np.frombuffer(recorded.valid, np.uint8)
    sums = np.frombuffer(made.sums, "<i4").copy()
    sums[~contract.phi.sums_of_blocks(valid != 0)] = 0
    return msgspec.structs.replace(recorded, sums=sums.tobytes(), valid=valid.tobytes(), fingerprint=made.fingerprint)


def _warn(line: str) -> None:
    say("replay", line)
