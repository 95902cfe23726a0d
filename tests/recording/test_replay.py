"""A replay makes of a recording what the services made live, and of a log what its frames tell."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from calibration.calibrator import Calibrator
from canskin.errors import InputError
from canskin.fabric import Mailbox
from canskin.messages import CONTACTS, IMAGE, LABEL, MEASUREMENT, Image, Label, Measurement, Topic
from classifier.service import ClassifierService
from dbc.contract import Contract
from dbc.frame import Frames, frames
from gateway.playback import play
from reconstructor.imaging import make_imager
from reconstructor.service import ReconstructorService
from recording.mcap_file import FRAMES, Entry, File, RecordingWriter, read_about, read_entries
from recording.recorder import Recorder
from recording.replaying import Replay
from recording.run_steps import steps_of
from recording.sinks import McapSink, open_sink
from recording.step_kinds import MeasurementStep
from shell.service import StopSignal
from tests import messages as make
from tests.gateway.boards import small_stepped
from tests.messages import stepped_measurement
from tests.recording.helpers import OFFSET_NS, FakeLink, messages_of

#: Of the live run: the number of its first cycle, a sum that was not used, and cycles without an image. Its offsets
#: change every four cycles.
FIRST, DEFECTIVE, SKIPPED = 500, 3, {502, 503}


class Live:
    """Publishes to a recorder, as the fabric does."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        self._recorder.take_message(topic, msgspec.msgpack.encode(message))

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        return Mailbox(depth)


def label_of(measurement: Measurement) -> Label:
    """A classifier of the test: it names the number of valid blocks."""
    return make.label(
        measurement.cycle,
        sync_counter=measurement.sync_counter,
        sampled_mono_ns=measurement.sampled_mono_ns,
        sampled_error_ns=measurement.sampled_error_ns,
        label=str(measurement.valid.count(1)),
        confidence=1.0,
        valid_sums=0,
    )


def as_published(contract: Contract, made: Measurement) -> Measurement:
    """A measurement as a gateway would have published it: with offsets, a sum that is not used, and doubt."""
    sums = len(made.sums) // 4
    return msgspec.structs.replace(
        made,
        offsets=(np.arange(sums) % 7 * 10 + made.cycle // 4).astype("<i4").tobytes(),
        usable=bytes(each != DEFECTIVE for each in range(sums)),
        doubtful=np.packbits(np.arange(256) < 128).tobytes() if made.cycle % 6 > 2 else b"",
        cycle=FIRST + made.cycle,
        wall_offset_ns=OFFSET_NS,
    )


@pytest.fixture
def run(contract: Contract, bus_frames: dict[int, Frames], links: dict[int, FakeLink], out: Path) -> Path:
    """A recorded run."""
    now = [int(bus_frames[0]["time_ns"][0])]
    sink = open_sink(out, contract, now[0] + OFFSET_NS, OFFSET_NS)
    recorder = Recorder(
        links, sink, {0: "left", 1: "right"}, wall_ns=lambda: now[0] + OFFSET_NS, mono_ns=lambda: now[0]
    )
    live = Live(recorder)
    service = ReconstructorService(contract.layout, make_imager(contract.layout), live, clock_ns=lambda: now[0])
    for part in play(contract, bus_frames):
        for bus, seen in part.frames.items():
            links[bus].coming.append(seen)
        for made in part.measurements:
            now[0] = made.sampled_mono_ns + 9_000_000
            published = as_published(contract, made)
            live.publish(MEASUREMENT, published)
            if published.cycle not in SKIPPED:
                service.take(published)
            live.publish(LABEL, label_of(published))
        recorder.turn()
    sink.close()
    return out


class StubClassifier(ClassifierService):
    def __init__(self, **changes: object) -> None:
        """It has no model, and makes the recorded labels with `changes`."""
        self._changes = changes

    def label(self, measurement: Measurement) -> Label | None:
        return msgspec.structs.replace(label_of(measurement), **self._changes)


@pytest.fixture
def replayed(contract: Contract, tmp_path: Path) -> Callable[..., tuple[Replay, Path]]:
    def play_again(source: Path, offset_ns: int = OFFSET_NS, *, every: bool = False) -> tuple[Replay, Path]:
        out = tmp_path / f"{source.stem}-again.mcap"
        sink = McapSink(out, contract, 1, offset_ns)
        replay = Replay(
            contract.layout,
            make_imager(contract.layout),
            lambda _: StubClassifier(),
            sink=sink,
            offset_ns=offset_ns,
        )
        replay.run(steps_of(source, contract, every=every), StopSignal(), float("inf"))
        sink.close()
        return replay, out

    return play_again


def test_all_is_as_live(run: Path, replayed: Callable[..., tuple[Replay, Path]], sums: np.ndarray) -> None:
    replay, out = replayed(run)
    assert messages_of(out, MEASUREMENT) == messages_of(run, MEASUREMENT)
    assert messages_of(out, LABEL) == messages_of(run, LABEL)

    def same(image: Image) -> Image:
        return msgspec.structs.replace(image, solve_s=0.0)

    assert list(map(same, messages_of(out, IMAGE))) == list(map(same, messages_of(run, IMAGE)))
    assert len(messages_of(out, CONTACTS)) == len(messages_of(run, CONTACTS)) == len(sums) - len(SKIPPED)
    assert messages_of(run, CONTACTS)[-1].contacts == messages_of(out, CONTACTS)[-1].contacts != []
    found = {each.cycle: each for each in messages_of(out, CONTACTS)}
    for each in messages_of(run, CONTACTS):
        assert found[each.cycle].contacts == each.contacts
    assert len({bool(each.doubtful) for each in messages_of(out, IMAGE)}) == 2
    report = replay.report
    assert report.measurements == len(sums)
    assert report.images.equal == report.images.compared == len(sums) - len(SKIPPED)
    assert report.lines()[0] == "12 measurements"


@pytest.mark.parametrize(
    ("changes", "is_equal"),
    [({"number": 753, "confidence": 1 - 1e-14}, True), ({"label": "cup"}, False), ({"confidence": 0.99}, False)],
)
def test_labels_are_equal_whatever_their_number(
    run: Path, contract: Contract, changes: dict[str, object], is_equal: bool
) -> None:
    """A recording may begin long after the classifier."""
    replay = Replay(contract.layout, make_imager(contract.layout), lambda _: StubClassifier(**changes))
    replay.run(steps_of(run, contract), StopSignal(), float("inf"))
    labels = replay.report.labels
    assert labels.compared > 0
    assert labels.equal == is_equal * labels.compared


def test_a_new_recording_can_be_replayed_itself(run: Path, replayed: Callable[..., tuple[Replay, Path]]) -> None:
    once = replayed(run)[1]
    replay, twice = replayed(once)
    assert messages_of(twice, MEASUREMENT) == messages_of(run, MEASUREMENT)
    assert [each.pixels for each in messages_of(twice, IMAGE)] == [each.pixels for each in messages_of(run, IMAGE)]
    assert replay.report.images.equal == replay.report.images.made > 0


def copy(run: Path, path: Path, entries: Iterable[Entry]) -> Path:
    """Copy a run with other entries."""
    about = read_about(run)
    writer = RecordingWriter(path, about.metadata, [File(name, "", each) for name, each in about.files.items()], 1)
    known: set[str] = set()
    for entry in entries:
        if entry.topic not in known:
            known.add(entry.topic)
            writer.add_topic(entry.topic, "", entry.about)
        writer.add(entry.topic, entry.time_ns, entry.data)
    writer.close()
    return path


@pytest.mark.parametrize("stands_s", [0.5, 5.0])
def test_a_recorder_that_stands_still_changes_nothing(
    run: Path, replayed: Callable[..., tuple[Replay, Path]], tmp_path: Path, stands_s: float
) -> None:
    """All comes, but what came meanwhile is recorded later: bus by bus, then the messages."""
    entries = list(read_entries(run, pytest.fail))
    half = len(entries) // 2
    went_on_ns = entries[-1].time_ns + round(stands_s * 1e9)
    late = sorted(entries[half:], key=lambda each: (not each.topic.startswith(FRAMES), each.topic))
    stood = copy(run, tmp_path / "stood.mcap", [*entries[:half], *(each._replace(time_ns=went_on_ns) for each in late)])
    _, out = replayed(stood)
    assert messages_of(out, MEASUREMENT) == messages_of(run, MEASUREMENT)
    assert [each.pixels for each in messages_of(out, IMAGE)] == [each.pixels for each in messages_of(run, IMAGE)]


def test_another_solver_uses_every_measurement(run: Path, replayed: Callable[..., tuple[Replay, Path]]) -> None:
    replay, _ = replayed(run, every=True)
    assert replay.report.images.made == replay.report.measurements


@pytest.mark.heavy
def test_a_log_has_the_sums_of_its_frames(
    contract: Contract,
    bus_frames: dict[int, Frames],
    sums: np.ndarray,
    tmp_path: Path,
    replayed: Callable[..., tuple[Replay, Path]],
) -> None:
    pixels = []
    for name in ("one.log", "two.blf", "three.mcap"):
        sink = open_sink(tmp_path / name, contract, 1, OFFSET_NS)
        for bus, seen in bus_frames.items():
            sink.frames(bus, seen, int(seen["time_ns"][-1]) + OFFSET_NS, OFFSET_NS)
        sink.close()
        _, out = replayed(tmp_path / name, OFFSET_NS if name == "three.mcap" else 0)
        made = messages_of(out, MEASUREMENT)
        np.testing.assert_array_equal([np.frombuffer(each.sums, "<i4") for each in made], sums)
        assert all(each.valid == b"\1" * 16 for each in made)
        pixels.append([each.pixels for each in messages_of(out, IMAGE)])
    assert pixels[0] == pixels[1] == pixels[2]


def test_a_log_without_a_complete_cycle_says_so(
    contract: Contract, bus_frames: dict[int, Frames], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The clock of one bus is behind that of the other by three periods."""
    sink = open_sink(tmp_path / "two.log", contract, 1, OFFSET_NS)
    for bus, seen in bus_frames.items():
        late = seen.copy()
        late["time_ns"] += bus * 30_000_000
        sink.frames(bus, late, int(late["time_ns"][-1]) + OFFSET_NS, OFFSET_NS)
    sink.close()
    assert list(steps_of(tmp_path / "two.log", contract))
    assert "none of 24 cycles is complete" in capsys.readouterr().err


def test_frames_alone_take_stored_offsets_and_a_recorded_run_has_its_own(
    contract: Contract, bus_frames: dict[int, Frames], run: Path, tmp_path: Path
) -> None:
    path = tmp_path / "frames.mcap"
    sink = open_sink(path, contract, 1, OFFSET_NS)
    for bus, seen in bus_frames.items():
        sink.frames(bus, seen, int(seen["time_ns"][-1]) + OFFSET_NS, OFFSET_NS)
    sink.close()
    offsets = np.arange(contract.phi.shape[0], dtype=np.int32)
    calibrator = Calibrator(contract.layout, offsets_n=offsets * contract.layout.taxels.newton_per_count, tares=False)

    def measured(source: Path) -> list[Measurement]:
        steps = steps_of(source, contract, calibrator=calibrator)
        return [step.measurement for step in steps if isinstance(step, MeasurementStep)]

    found = measured(path)
    assert found
    for each in found:
        np.testing.assert_array_equal(np.frombuffer(each.offsets, "<i4"), offsets)
    with pytest.raises(InputError, match="measurements have the offsets of the run"):
        measured(run)


def with_measurement(contract: Contract, path: Path, measurement: Measurement, seen: Frames) -> Path:
    """Return a recording of some frames of the first bus and one measurement."""
    sink = McapSink(path, contract, 1, 0)
    if len(seen):
        sink.frames(0, seen, int(seen["time_ns"][-1]), 0)
    sink.message(MEASUREMENT, 1, msgspec.msgpack.encode(measurement))
    sink.close()
    return path


def played(path: Path, contract: Contract) -> list[Measurement]:
    return [step.measurement for step in steps_of(path, contract) if isinstance(step, MeasurementStep)]


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"bus_sampled_ns": bytes(8)}, "one.mcap: bus_sampled_ns of 8 bytes, expected 16, or none"),
        ({"known": b""}, "one.mcap: known of 0 bytes, expected 128"),
        ({"sums": b""}, "one.mcap: sums of 0 bytes, expected 512"),
        ({"fingerprint": "0" * 16}, "one.mcap: measured with Φ '0000000000000000', expected"),
    ],
)
def test_an_stepped_measurement_that_does_not_fit_is_refused(
    tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    contract = small_stepped()
    force_n = np.zeros(contract.layout.taxels.count)
    good = stepped_measurement(force_n, layout=contract.layout, bus_sampled_ns=bytes(16))
    some = frames(1)
    path = with_measurement(contract, tmp_path / "good.mcap", good, some)
    assert played(path, contract) == [good]
    bad = msgspec.structs.replace(good, **changed)
    path = with_measurement(contract, tmp_path / "one.mcap", bad, some)
    with pytest.raises(InputError, match=said):
        played(path, contract)


def test_a_recording_of_another_layout_is_refused(
    run: Path, contract: Contract, bus_frames: dict[int, Frames], tmp_path: Path
) -> None:
    measurement = contract.layout.measurement
    other = Contract.from_layout(
        msgspec.structs.replace(contract.layout, measurement=msgspec.structs.replace(measurement, seed=7))
    )
    frames_alone = tmp_path / "frames.mcap"
    sink = open_sink(frames_alone, contract, 1, OFFSET_NS)
    sink.frames(0, bus_frames[0], int(bus_frames[0]["time_ns"][-1]) + OFFSET_NS, OFFSET_NS)
    sink.close()
    assert other.phi.fingerprint != contract.phi.fingerprint
    with pytest.raises(InputError, match=r"run.mcap: measured with Φ .* expected .*: give both ends the same --layout"):
        played(run, other)
    with pytest.raises(InputError, match=r"frames.mcap: measured with Φ"):
        played(frames_alone, other)


def test_measurements_without_frames_are_played(run: Path, contract: Contract, tmp_path: Path) -> None:
    recorded = messages_of(run, MEASUREMENT)[0]
    path = with_measurement(contract, tmp_path / "one.mcap", recorded, frames(0))
    assert recorded.bus_sampled_ns
    assert played(path, contract) == [recorded]
