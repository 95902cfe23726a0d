"""What comes is in the file: frames of every bus, and messages as they were published."""

import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bandwidth.logs import read_log
from bus.link import State
from calibration import attachment
from calibration.attachment import follow_calibration
from canskin.calibration_messages import CalibrationReply, CalibrationRequest, CalibrationState, CalibrationStatus
from canskin.errors import BusError, InputError, RunError
from canskin.fabric import Fabric, Origin
from canskin.messages import IMAGE, LABEL, MARK, GatewayStatus, Topic
from canskin.question import Question
from dbc.contract import Contract
from dbc.frame import ERROR, EXTENDED, REMOTE, Frames, frames
from dbc.generate import contract_files
from recording import record_command
from recording.mcap_file import (
    CALIBRATION_FILE,
    EVENTS,
    LONGEST_MESSAGE,
    RECORDER,
    File,
    newest_file,
    read_about,
    read_entries,
)
from recording.recorder import MOST_WAITING, Recorder
from recording.sinks import check_format, open_sink
from shell.service import StopSignal
from shell.skin_options import SkinOptions, join
from skin.layout import parse_layout
from tests import messages as make
from tests.client.helpers import await_peers
from tests.layouts import buses, small_contract
from tests.processes import free_endpoint
from tests.recording.helpers import OFFSET_NS, FakeLink, messages_of

START_NS = 1_700_000_000_000_000_000


class Run:
    """A recorder on links of the test, and its clock."""

    def __init__(self, path: Path, contract: Contract, links: dict[int, FakeLink]) -> None:
        self.wall_ns = START_NS
        names = {number: bus.name for number, bus in enumerate(contract.layout.bus)}
        self.sink = open_sink(path, contract, START_NS, OFFSET_NS)
        self.recorder = Recorder(
            links, self.sink, names, wall_ns=lambda: self.wall_ns, mono_ns=lambda: self.wall_ns - OFFSET_NS
        )

    def turn(self, after_s: float = 0.05) -> None:
        self.wall_ns += round(after_s * 1e9)
        self.recorder.turn()


def brought(links: dict[int, FakeLink], bus_frames: dict[int, Frames]) -> None:
    for number, link in links.items():
        link.coming += np.array_split(bus_frames[number], 5)


@pytest.mark.parametrize("name", ["run.mcap", "run.log", "run.blf", "run.asc", "run.trc"])
def test_every_frame_is_in_the_file(
    contract: Contract, links: dict[int, FakeLink], bus_frames: dict[int, Frames], tmp_path: Path, name: str
) -> None:
    run = Run(tmp_path / name, contract, links)
    brought(links, bus_frames)
    run.turn()
    run.turn(0.6)
    run.sink.close()
    assert run.recorder.frames == sum(map(len, bus_frames.values()))
    logged = read_log(tmp_path / name, pytest.fail)
    assert len(logged) == 2
    for (channel, found), (number, sent) in zip(sorted(logged.items()), bus_frames.items(), strict=True):
        if name in {"run.mcap", "run.log"}:
            assert channel == contract.layout.bus[number].name
        for field in ("can_id", "length", "flags", "data"):
            np.testing.assert_array_equal(found[field], sent[field])
        late_ns = found["time_ns"] - sent["time_ns"]
        np.testing.assert_allclose(late_ns, late_ns[0], atol=0 if name == "run.mcap" else 1_000_000)
        if name == "run.mcap":
            assert late_ns[0] == OFFSET_NS


#: Formats that are written and read without a further package.
SUFFIXES = (".mcap", ".log", ".asc", ".blf", ".trc", ".csv", ".db")
ONE_BUS = small_contract(bus=buses(4))


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.lists(st.sampled_from([0, 0, 0, EXTENDED, REMOTE, ERROR]), max_size=300), max_size=8))
def test_a_recorder_counts_what_the_file_holds(tmp_path: Path, suffix: str, turns: list[list[int]]) -> None:
    """Frames of every kind come as fast as they can, and the file is closed after any turn."""
    path = tmp_path / f"run{suffix}"
    path.unlink(missing_ok=True)
    link = FakeLink()
    run = Run(path, ONE_BUS, {0: link})
    for flags in turns:
        came = frames(len(flags))
        came["flags"], came["can_id"], came["length"] = flags, 0x181, 8
        came["time_ns"] = run.wall_ns - OFFSET_NS + np.arange(len(flags))
        link.coming.append(came)
        run.turn()
    run.sink.close()
    came_in_all = sum(map(len, turns))
    assert run.recorder.frames + run.recorder.left_out == came_in_all
    held = [flag for flags in turns for flag in flags if suffix != ".trc" or flag not in {REMOTE, ERROR}]
    assert run.recorder.frames == len(held)
    if held:
        (found,) = read_log(path, pytest.fail).values()
        assert found["flags"].tolist() == held


#: Writes frames without end, a millisecond apart, and tells after each flush how many came.
WRITER = """
import sys
from pathlib import Path
import numpy as np
from dbc.frame import frames
from recording.sinks import open_sink
from tests.layouts import buses, small_contract

sink, count = open_sink(Path(sys.argv[1]), small_contract(bus=buses(4)), 0, 10**18), 0
while True:
    came = frames(37)
    came["time_ns"] = (count + np.arange(37)) * 1_000_000
    came["can_id"], came["length"] = (count + np.arange(37)) % 1024, 8
    sink.frames(0, came, int(came["time_ns"][-1]), 10**18)
    count += 37
    if count % 5 == 0:
        sink.flush()
        print(count, flush=True)
"""


@pytest.mark.heavy
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_recorder_that_is_killed_leaves_all_but_the_last_moment(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        for _ in range(np.random.default_rng().integers(1, 40)):
            flushed = int(writer.stdout.readline())
        writer.kill()
    (found,) = read_log(path, lambda _: None).values()
    assert len(found) >= flushed - 100  # frames of several buses wait 100 ms for each other
    assert (found["can_id"] == np.arange(len(found)) % 1024).all()


def test_a_full_disk_is_said_of_a_database_too(tmp_path: Path) -> None:
    (tmp_path / "is a folder.db").mkdir()
    with pytest.raises(OSError, match="SQLite"):
        open_sink(tmp_path / "is a folder.db", ONE_BUS, 0, 0)


def test_a_database_whose_last_rows_fail_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(sqlite3.Connection):
        def commit(self) -> None:
            raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Full))
    sink = open_sink(tmp_path / "run.db", ONE_BUS, 0, 0)
    with pytest.raises(OSError, match="disk is full"):
        sink.close()
    assert "run.db" not in [each.readlink().name for each in Path("/proc/self/fd").iterdir() if each.exists()]


@pytest.mark.parametrize("name", ["run.mcap", "run.log"])
def test_a_file_without_an_end_lacks_the_last_second_at_most(
    contract: Contract, links: dict[int, FakeLink], bus_frames: dict[int, Frames], tmp_path: Path, name: str
) -> None:
    run = Run(tmp_path / name, contract, links)
    for _ in range(50):
        for number, link in links.items():
            one = bus_frames[number][:1].copy()
            one["time_ns"] = run.wall_ns - OFFSET_NS
            link.coming.append(one)
        run.turn()
        if run.wall_ns - START_NS > 1e9:
            newest_ns = [int(seen["time_ns"][-1]) for seen in read_log(tmp_path / name, lambda _: None).values()]
            assert len(newest_ns) == 2
            assert run.wall_ns - min(newest_ns) < 1e9
    run.sink.close()


def test_messages_events_and_counters_are_in_the_file(
    contract: Contract, links: dict[int, FakeLink], bus_frames: dict[int, Frames], out: Path
) -> None:
    run = Run(out, contract, links)
    brought(links, bus_frames)
    links[1].dropped = 7
    run.recorder.take_message(LABEL, b"a label")
    run.recorder.take_event("gateway", "is there")
    links[0].state = State.LOST
    run.turn()
    links[0].state = State.ACTIVE
    run.turn(0.6)
    # Not closed: all of it is in the file already.
    entries = list(read_entries(out, lambda _: None))
    labels = [entry for entry in entries if entry.topic == LABEL.name]
    assert [(entry.time_ns, entry.data) for entry in labels] == [(START_NS, b"a label")]
    events = [msgspec.json.decode(entry.data)["text"] for entry in entries if entry.topic == EVENTS]
    assert events == ["is there", "left is lost", "left is back"]
    (counters,) = [msgspec.json.decode(entry.data) for entry in entries if entry.topic == RECORDER]
    assert counters["frames"] == sum(map(len, bus_frames.values()))
    assert counters["lost_frames"] == {"left": 0, "right": 7}
    assert counters["wall_offset_ns"] == OFFSET_NS
    assert run.recorder.lost == 7
    run.sink.close()


def test_layout_contract_and_versions_are_attached(contract: Contract, links: dict[int, FakeLink], out: Path) -> None:
    Run(out, contract, links).sink.close()
    about = read_about(out)
    assert parse_layout(about.files["layout.toml"], "layout.toml") == contract.layout
    files = {name: text.encode() for name, text in contract_files(contract).items()}
    assert {name: about.files[name] for name in files} == files
    assert about.metadata["fingerprint"] == contract.phi.fingerprint
    assert {"canskin", "numpy", "python", "mcap"} <= set(about.metadata)


def test_a_calibration_is_attached_whenever_it_comes(contract: Contract, links: dict[int, FakeLink], out: Path) -> None:
    run = Run(out, contract, links)
    for content in (b"old", b"new"):
        run.recorder.take_message(LABEL, b"a label")
        run.turn()
        run.recorder.take_file(File(CALIBRATION_FILE, "application/json", content))
    run.turn(0.6)
    assert newest_file(out, CALIBRATION_FILE) == b"new"  # not closed
    run.sink.close()
    assert newest_file(out, CALIBRATION_FILE) == b"new"
    assert newest_file(out, "nothing") is None


def status(calibration: CalibrationStatus | None, cycles: int = 0) -> GatewayStatus:
    return make.gateway_status(cycles, calibration=calibration)


class Gateway:
    """A fabric with a gateway that answers as it is told; the recording stops after its last status."""

    def __init__(self, statuses: list[GatewayStatus], answers: list[CalibrationReply | BusError]) -> None:
        self._statuses, self._answers = statuses, answers
        self.stop = StopSignal()
        self.asked: list[int] = []
        self._cycles = 0

    def mailbox(self, _topic: Topic, _depth: int) -> "Gateway":
        return self

    def get(self, _timeout_s: float) -> GatewayStatus | None:
        newest = self._statuses.pop(0)
        self._cycles = newest.cycles
        if not self._statuses:
            self.stop.set()
        return newest

    def ask(self, _question: Question, _request: CalibrationRequest, _timeout_s: float) -> CalibrationReply:
        self.asked.append(self._cycles)
        answer = self._answers.pop(0)
        if isinstance(answer, BusError):
            raise answer
        return answer


SHOWN = CalibrationReply(is_done=True, text="", content=b"gains")


def test_the_calibration_is_asked_for_after_each_change() -> None:
    following = partial(CalibrationStatus, state=CalibrationState.FOLLOWING)
    found = (
        (None, 1),
        (following(tared_mono_ns=1), 2),
        (following(tared_mono_ns=1, noise_n=2.0), 3),
        (following(tared_mono_ns=2), 4),
        (following(tared_mono_ns=2, revision=1), 5),
        (following(tared_mono_ns=2, revision=1), 6),
        (following(tared_mono_ns=2, revision=1), 1),  # the gateway has started again
    )
    fabric = Gateway([status(each, cycles) for each, cycles in found], [SHOWN] * 4)
    files: list[File] = []
    follow_calibration(cast("Fabric", fabric), files.append, fabric.stop)
    assert fabric.asked == [2, 4, 5, 1]
    assert [each.content for each in files] == [b"gains"] * 4


def test_a_change_is_asked_for_until_the_gateway_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attachment, "_AGAIN_S", 0.0)
    busy = CalibrationReply(is_done=False, text="8 requests wait")
    unchanged = status(CalibrationStatus(state=CalibrationState.FOLLOWING))
    fabric = Gateway([unchanged] * 4, [BusError("no service answers"), busy, SHOWN])
    files: list[File] = []
    follow_calibration(cast("Fabric", fabric), files.append, fabric.stop)
    assert [each.content for each in files] == [b"gains"]


def test_a_log_leaves_messages_out(contract: Contract, links: dict[int, FakeLink], tmp_path: Path) -> None:
    run = Run(tmp_path / "run.log", contract, links)
    run.recorder.take_message(LABEL, b"a label")
    run.turn()
    assert run.recorder.messages == 0
    run.sink.close()


def test_messages_that_never_came_are_counted_by_topic(
    contract: Contract, links: dict[int, FakeLink], out: Path
) -> None:
    run = Run(out, contract, links)
    # Two publishers of labels; the first starts again. Numbers 6, 7 and 9 of the first do not come, 8 comes late.
    for publisher, number in (("a", 5), ("b", 1), ("a", 10), ("a", 8), ("b", 2), ("c", 1), ("c", 2)):
        run.recorder.take_message(LABEL, b"", Origin(publisher, number))
    run.recorder.take_message(IMAGE, b"", Origin("a", 3))
    run.recorder.take_message(IMAGE, b"")
    run.turn(0.6)
    (counters,) = [
        msgspec.json.decode(entry.data) for entry in read_entries(out, lambda _: None) if entry.topic == RECORDER
    ]
    assert counters["missed_messages"] == {"label": 3}
    assert counters["lost_messages"] == 0
    run.sink.close()


def test_too_many_messages_are_counted(contract: Contract, links: dict[int, FakeLink], out: Path) -> None:
    run = Run(out, contract, links)
    for _ in range(MOST_WAITING + 3):
        run.recorder.take_message(LABEL, b"")
    assert run.recorder.lost == 3
    run.sink.abandon()


@pytest.mark.heavy
@pytest.mark.parametrize(("label", "marks"), [("cup", ["cup"]), (None, [])])
def test_a_label_holds_from_the_start_of_a_recording_and_is_not_what_was_recorded(
    contract: Contract,
    links: dict[int, FakeLink],
    bus_frames: dict[int, Frames],
    layout_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    label: str | None,
    marks: list[str],
) -> None:
    monkeypatch.setattr(record_command, "open_links", lambda *_, **__: links)
    monkeypatch.setattr(StopSignal, "install", lambda self: self)
    one, none = tmp_path / "one.mcap", tmp_path / "none.mcap"
    of = SkinOptions(layout=layout_file, connect=free_endpoint())
    recorded = partial(record_command.record, of=of, seconds=0.01, label=label)
    with pytest.raises(RunError, match="nothing came"):
        recorded(none)
    brought(links, bus_frames)
    recorded(one)
    assert [each.label for each in messages_of(one, MARK)] == marks


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("run.log", {"label": "cup"}, "--label: expected a recording that ends in .mcap"),
        ("run.log", {"frames": False}, "--no-frames: expected a recording that ends in .mcap"),
        ("run.mcap", {"label": "a\nb"}, "expected printable text"),
    ],
)
def test_what_cannot_be_recorded_is_refused(
    layout_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, options: dict[str, Any], says: str
) -> None:
    monkeypatch.setattr(StopSignal, "install", lambda self: self)
    with pytest.raises(InputError, match=says):
        record_command.record(tmp_path / name, of=SkinOptions(layout=layout_file), **options)


@pytest.mark.parametrize(
    ("name", "fd", "words"),
    [
        ("run.xyz", (False,), "expected a file that ends in"),
        ("run.csv", (False, False), "does not tell"),
        ("run.db", (True,), "does not hold CAN FD"),
        ("run.trc", (False, True), "does not hold CAN FD"),
    ],
)
def test_formats_that_cannot_hold_the_frames_are_refused(name: str, fd: tuple[bool, ...], words: str) -> None:
    check_format(Path("run.csv"), ONE_BUS.layout)
    lines = tuple(msgspec.structs.replace(ONE_BUS.layout.bus[0], fd=each) for each in fd)
    with pytest.raises(InputError, match=words):
        check_format(Path(name), msgspec.structs.replace(ONE_BUS.layout, bus=lines))


@pytest.mark.heavy
def test_no_thread_waits_for_a_hub_when_the_recorder_ends(
    contract: Contract, links: dict[int, FakeLink], layout_file: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread inside zenoh at the end of the interpreter aborts the process."""
    monkeypatch.setattr(record_command, "open_links", lambda *_, **__: links)
    before = set(threading.enumerate())
    with handlers_kept(), pytest.raises(RunError, match="nothing came"):
        record_command.record(out, of=SkinOptions(layout=layout_file, connect=free_endpoint()), seconds=0.01)
    assert set(threading.enumerate()) <= before


@contextmanager
def handlers_kept() -> Iterator[None]:
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def test_a_recording_follows_a_gateway_that_starts_again_and_ends_where_its_layout_is_another(
    contract: Contract,
    links: dict[int, FakeLink],
    bus_frames: dict[int, Frames],
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(record_command, "open_links", lambda *_, **__: links)
    layout, endpoint = contract.layout, free_endpoint()
    slower = msgspec.structs.replace(layout, sync=msgspec.structs.replace(layout.sync, rate_hz=50.0))
    hub, gateway = Fabric(layout.name, "hub", endpoint, hub=True), join(layout, "gateway", endpoint)

    def start_again() -> None:
        await_peers(hub, f"{layout.name}/recorder")
        gateway.close()
        brought(links, bus_frames)
        again = join(layout, "gateway", endpoint)
        await_peers(hub, f"{layout.name}/gateway")
        again.close()
        gateways.append(join(slower, "gateway", endpoint))

    gateways: list[Fabric] = []
    starting = threading.Thread(target=start_again)
    starting.start()
    with handlers_kept(), pytest.raises(RunError, match=r"another layout now: `\$.sync.rate_hz` is 100.0, there 50.0"):
        record_command.record(out, of=SkinOptions(connect=endpoint))
    starting.join()
    for fabric in (*gateways, hub):
        fabric.close()
    logged = read_log(out, pytest.fail)
    assert sum(map(len, logged.values())) == sum(map(len, bus_frames.values()))
    events = [
        msgspec.json.decode(entry.data)["text"] for entry in read_entries(out, pytest.fail) if entry.topic == EVENTS
    ]
    assert any("another layout" in each for each in events)


def test_a_message_that_no_reader_would_take_is_lost_and_the_file_stays_readable(
    contract: Contract, links: dict[int, FakeLink], out: Path
) -> None:
    run = Run(out, contract, links)
    run.recorder.take_message(LABEL, bytes(LONGEST_MESSAGE + 1))
    run.recorder.take_message(LABEL, bytes(LONGEST_MESSAGE))
    run.turn(0.6)
    run.sink.close()
    assert (run.recorder.lost, run.recorder.messages) == (1, 1)
    assert [len(each.data) for each in read_entries(out, pytest.fail) if each.topic == LABEL.name] == [LONGEST_MESSAGE]
