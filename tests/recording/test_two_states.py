"""A run of nodes with two states: recorded, measured from its frames again, rebuilt, exported, and compared."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bandwidth.departures import departures
from bandwidth.measured import measure_states, misfits, switches
from bandwidth.plan import BusPlan, plan_bus
from bandwidth.traffic import Disturbance
from canskin.messages import IMAGE, MEASUREMENT, RECOGNITION, Label, Measurement
from classifier.service import ClassifierService
from dbc.frame import ECHO, Frames, frames
from dbc.state_frames import asked_states
from gateway.playback import play
from reconstructor.imaging import make_imager
from recording import rebuild_command
from recording.rebuild_command import rebuild
from recording.replaying import Replay, Report
from recording.sinks import McapSink
from recording.step_kinds import MeasurementStep
from recording.steps import steps_of
from recording.tables import read_tables
from shell.service import StopSignal
from skin.layout import load_layout
from skin.measured_sums import published
from tests import messages as make
from tests.gateway.helpers import World, two_states
from tests.recording.helpers import messages_of

CONTRACT = two_states()
IMAGES, FEW = CONTRACT.states


class Recorded(World):
    """A skin with two states whose frames are kept as the gateway reads them."""

    step_s = 0.0025

    def __init__(self) -> None:
        self.kept: dict[int, list[Frames]] = {bus: [frames(0)] for bus in range(2)}
        super().__init__(CONTRACT)

    def _receive(self) -> None:
        for bus, wire in enumerate(self.wires):
            self.kept[bus] += [burst.copy() for burst in wire.gateway.waiting]
        super()._receive()

    def logged(self) -> dict[int, Frames]:
        """Return the frames as a recorder has them."""
        seen = {bus: np.concatenate(kept) for bus, kept in self.kept.items()}
        for each in seen.values():
            each["flags"] &= ~np.uint8(ECHO)
            # A SYNC has the time when it was due, up to a step before the frames that went out with it.
            each["time_ns"] = np.minimum.accumulate(each["time_ns"][::-1])[::-1]
        return seen


@pytest.fixture(scope="module")
def run() -> Recorded:
    """Return a run with recognition, images, recognition again."""
    world = Recorded()
    world.run(0.8)
    assert world.gateway.states is not None
    world.gateway.states.ask_images(0.3)
    world.run(0.6)
    return world


def heads(measured: list[Measurement]) -> list[tuple[str, int, bytes]]:
    return [(each.fingerprint, each.sampled_mono_ns, each.sums) for each in measured]


def test_frames_give_the_measurements_of_both_states(run: Recorded) -> None:
    """A recording that begins among images, before any switch, begins in that state."""
    live = [each for each in run.measured if any(each.valid)]
    assert {each.fingerprint for each in live} == {IMAGES.phi.fingerprint, FEW.phi.fingerprint}
    made = [each for part in play(CONTRACT, run.logged()) for each in part.measurements]
    assert heads([each for each in made if any(each.valid)])[-len(live) :] == heads(live)
    images = [each for each in run.measured if each.fingerprint == IMAGES.phi.fingerprint]
    begin_ns = images[2].sampled_mono_ns - 1_000_000
    late = {bus: seen[seen["time_ns"] >= begin_ns] for bus, seen in run.logged().items()}
    made = [each for part in play(CONTRACT, late) for each in part.measurements]
    expected = [each for each in run.measured if each.sampled_mono_ns >= begin_ns]
    assert [each.fingerprint for each in made[:-1]] == [each.fingerprint for each in expected[: len(made) - 1]]


class Counting(ClassifierService):
    """A classifier of the test: it names the number of valid blocks."""

    def __init__(self) -> None:
        """It has no model."""

    def label(self, measurement: Measurement) -> Label | None:
        assert measurement.fingerprint == FEW.phi.fingerprint
        about = {"sync_counter": measurement.sync_counter, "sampled_mono_ns": measurement.sampled_mono_ns}
        error_ns = measurement.sampled_error_ns
        return make.label(measurement.cycle, **about, sampled_error_ns=error_ns, label=str(measurement.valid.count(1)))


@pytest.fixture(scope="module")
def recording(run: Recorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what a recorder writes of the run, images and labels included."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    sink = McapSink(path, CONTRACT, 1, 0)
    replay = Replay(CONTRACT.layout, make_imager(CONTRACT.layout), lambda _: Counting(), sink=sink)
    for bus, seen in run.logged().items():
        sink.frames(bus, seen, int(seen["time_ns"][0]), 0)
    for each in run.measured:
        replay.take(MeasurementStep(each.sampled_mono_ns + 1_000_000, each))
    sink.close()
    return path


def test_a_recording_has_both_topics_and_a_replay_gives_them_again(run: Recorded, recording: Path) -> None:
    told = [each for made in run.measured for each in published(made, FEW.phi, CONTRACT.recognised)]
    for topic in (MEASUREMENT, RECOGNITION):
        assert messages_of(recording, topic) == [message for name, message in told if name is topic]
    replay = Replay(CONTRACT.layout, make_imager(CONTRACT.layout), lambda _: Counting())
    replay.run(steps_of(recording, CONTRACT), StopSignal(), float("inf"))
    count, images = len(run.measured), len(messages_of(recording, IMAGE))
    assert 0 < images < count
    report: Report = replay.report
    found = [(each.made, each.compared, each.equal) for each in (report.measurements, report.images, report.labels)]
    assert found == [(count, count, count), (images, images, images), (count, count, count)]


def test_images_are_rebuilt_and_recognition_is_exported(
    run: Recorded, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr(rebuild_command, "say", lambda _, line: said.append(line))
    rebuild(recording, out=tmp_path / "images.npz")
    images = len(messages_of(recording, IMAGE))
    assert f"{images} of {images} images equal to the recorded" in said
    with np.load(tmp_path / "images.npz") as made:
        assert made["images"].shape == (images, 8, 16)
    tables = read_tables(recording, load_layout(recording), pytest.fail)
    assert tables.recognition["sums"].shape == (len(run.measured), FEW.phi.shape[0])
    assert len(tables.measurements["sums"]) == images


def left(seen: Frames) -> list[str]:
    """Return what is said of bus 0, in the order of `Contract.states`."""
    plans: list[BusPlan] = [plan_bus(state, bus, None, Disturbance()) for state in CONTRACT.states for bus in range(2)]
    parts = measure_states(CONTRACT, 0, seen, plans)
    assert [line for each in parts for line in misfits(CONTRACT, 0, each.frames, each.load)] == []
    for each, state in zip(parts, CONTRACT.states, strict=True):
        assert each.load.seconds == pytest.approx(
            len(each.frames[each.frames["can_id"] == 0x80][1:]) / state.layout.sync.rate_hz
        )
    return departures(CONTRACT, 0, seen, parts)


def without(seen: Frames, places: Any) -> Frames:
    less: Frames = np.delete(seen, places)
    return less


def test_each_state_is_compared_with_its_plan(run: Recorded) -> None:
    seen = run.logged()[0]
    seen = seen[np.flatnonzero(seen["can_id"] == 0x80)[1] :]
    assert left(seen) == []
    (_, first), (_, second) = switches(CONTRACT, 0, seen)
    assert (first, second) == ("images", "recognition")
    few, many = ({tpdo.cob_id for tpdo in state.on_bus(0)[0].tpdos} for state in (FEW, IMAGES))
    lost = [np.flatnonzero(np.isin(seen["can_id"], list(each)))[3] for each in (few, many)]
    assert left(without(seen, lost)) == [
        "bus0, images: node 1: 1 TPDOs missing",
        "bus0, recognition: node 1: 1 TPDOs missing",
    ]
    # A node that has missed the switch sends on as before.
    astray = seen.copy()
    place = np.flatnonzero(np.isin(seen["can_id"], list(many)))[5]
    astray["can_id"][place], astray["length"][place] = min(few), FEW.on_bus(0)[0].tpdos[0].length
    assert "bus0, images: node 1: 1 TPDOs of the other state" in left(astray)


def test_only_whole_frames_ask_for_a_state(run: Recorded) -> None:
    seen = run.logged()[0]
    found = asked_states(seen)
    assert len({state for _, state in found}) == 2
    seen["length"] += 1
    assert asked_states(seen) == []
