"""A running skin is recorded, the recorder is killed, and the run is played again in another process."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from bandwidth.logs import read_log
from canskin.messages import CONTACTS, IMAGE, LABEL, MEASUREMENT, TRUTH, Contacts, Image, Measurement, Topic
from dbc.canopen import SYNC_COB_ID
from recording.mcap_file import read_entries
from tests.processes import PATIENCE_S
from tests.system.conftest import Chain

pytestmark = pytest.mark.slow


def messages(path: Path, topic: Topic) -> list[Any]:
    decode = topic.decoder()
    return [decode(entry.data) for entry in read_entries(path, lambda _: None) if entry.topic == topic.name]


def as_compared(message: Any) -> Any:
    """Return a message without the times that the services took, and without who was to publish."""
    if isinstance(message, Image):
        return message.pixels, message.valid, message.valid_sums, message.sampled_mono_ns
    if isinstance(message, Measurement):
        return msgspec.structs.replace(message, duty="")
    return msgspec.structs.replace(message, find_s=0.0) if isinstance(message, Contacts) else message


def replayed(source: Path, out: Path, *options: str) -> str:
    """Play a file into a new recording, in another process; return what it says."""
    command = [sys.executable, "-m", "skin", "replay", str(source), "--out", str(out), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stderr


def start_chain(chain: Chain) -> None:
    chain.start_bus()
    chain.start("nodes", "nodes", "--objects", "golf-ball,granola-box")
    chain.start("reconstructor", "reconstruct")
    chain.start("classifier", "classify")
    chain.until_alive("nodes", "reconstructor", "classifier")


def start_recorder(chain: Chain, name: str, out: Path) -> int:
    """Start a recorder and wait until its file is there."""
    pid = chain.start(name, "record", str(out))
    chain.await_words(name, f"to {out}")
    return pid


def test_a_replay_gives_the_live_measurements_images_and_labels(chain: Chain, tmp_path: Path) -> None:
    start_chain(chain)
    run, log, blf = (tmp_path / f"run.{suffix}" for suffix in ("mcap", "log", "blf"))
    for path in (run, log, blf):
        start_recorder(chain, path.suffix[1:], path)
    chain.until_alive("recorder")
    chain.start("gateway", "gateway")
    chain.until("labels of a contact", lambda: sum(bool(label.label) for label in chain.labels) > 40)
    for path in (run, log, blf):
        chain.supervisor.stop(path.suffix[1:])
    chain.supervisor.stop_at_once()  # replays have the machine for themselves

    recorded = {topic.name: messages(run, topic) for topic in (MEASUREMENT, IMAGE, CONTACTS, LABEL, TRUTH)}
    assert all(len(each) > 40 for each in recorded.values())
    live = {each.cycle: each for each in chain.measurements}
    both = [each for each in recorded["measurement"] if each.cycle in live]  # a busy machine loses some on either way
    assert len(both) > 20
    assert all(live[each.cycle] == each for each in both)

    out = tmp_path / "out.mcap"
    said = replayed(run, out)
    made = {topic.name: messages(out, topic) for topic in (MEASUREMENT, IMAGE, CONTACTS, LABEL)}
    # A busy machine may lose a measurement on the way to a recorder: images and labels remember those before.
    known = {each.cycle for each in recorded["measurement"]}
    end = next(cycle for cycle in range(min(known), max(known) + 2) if cycle not in known)
    for name, messages_made in made.items():
        by_cycle = {each.cycle: as_compared(each) for each in messages_made}
        compared = [each for each in recorded[name] if each.cycle < end]
        assert len(compared) > 20, said
        for each in compared:
            assert by_cycle.get(each.cycle) == as_compared(each), f"{name}: {said}"

    sources = {"again": (out,), **{path.suffix[1:]: (path, "--layout", str(chain.layout_path)) for path in (log, blf)}}
    with ThreadPoolExecutor() as threads:
        for done in [
            threads.submit(replayed, source, tmp_path / f"{name}.mcap", *options)
            for name, (source, *options) in sources.items()
        ]:
            done.result()

    # A recording that a replay wrote gives the same again.
    assert messages(tmp_path / "again.mcap", MEASUREMENT) == made["measurement"]
    assert [each.pixels for each in messages(tmp_path / "again.mcap", IMAGE)] == [each.pixels for each in made["image"]]

    # Logs hold frames alone: sums of the same cycles, in which every node counts as proven.
    complete = [each for each in recorded["measurement"] if b"\0" not in each.valid]
    assert len(complete) > 20  # a busy host leaves gaps
    for name in ("log", "blf"):
        sums = {each.sums for each in messages(tmp_path / f"{name}.mcap", MEASUREMENT)}
        assert all(each.sums in sums for each in complete)
    # The recorders did not end together, and the last cycles of the first to end may be cut.
    logs = [[each.pixels for each in messages(tmp_path / f"{name}.mcap", IMAGE)] for name in ("log", "blf")]
    common = min(map(len, logs)) - 2
    assert logs[0][:common] == logs[1][:common]


def test_the_disk_is_full_for_one_recorder_and_others_are_killed(chain: Chain, tmp_path: Path) -> None:
    """The first ends alone. What was in the files of the others while they recorded is readable after their end."""
    start_chain(chain)
    full, run, log = tmp_path / "full.mcap", tmp_path / "run.mcap", tmp_path / "run.log"
    pids = [start_recorder(chain, path.suffix[1:], path) for path in (run, log)]
    with limited_recorder(chain, full) as recorder:
        chain.until_alive("recorder")
        chain.start("gateway", "gateway")
        _, errors = recorder.communicate(timeout=PATIENCE_S)
    assert recorder.returncode == 1, errors
    last = errors.splitlines()[-1]
    assert last == f"skin: {full}: the recording ends: File too large; what was written before is readable"
    chain.until("images", lambda: len(chain.images) > 60)
    now_ns = time.time_ns()
    chain.poll("frames of now in the files", lambda: all(has_frames_of(each, now_ns, []) for each in (run, log)))
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    killed = chain.measurements[-1].cycle
    chain.until("images after it", lambda: chain.images[-1].cycle > killed + 20)
    chain.supervisor.stop_at_once()

    said: list[str] = []
    assert sum(entry.topic == IMAGE.name for entry in read_entries(full, said.append)) > 10
    assert has_frames_of(run, now_ns, said)
    assert [text.count("has no end") for text in said] == [1, 1]
    assert has_frames_of(log, now_ns, said)
    replayed(run, tmp_path / "out.mcap")
    made = {each.cycle: each for each in messages(tmp_path / "out.mcap", MEASUREMENT)}
    recorded = [each for each in messages(run, MEASUREMENT) if each.cycle <= max(made)]
    assert len(recorded) > 40
    assert [each for each in map(as_compared, recorded) if made.get(each.cycle) != each] == []


def has_frames_of(path: Path, time_ns: int, said: list[str]) -> bool:
    """Tell whether a SYNC of each bus is in a file that was sent at a time or later."""
    logged = read_log(path, said.append).values()
    newest_ns = [int(frames["time_ns"][frames["can_id"] == SYNC_COB_ID].max(initial=0)) for frames in logged]
    return len(newest_ns) == 4 and min(newest_ns) >= time_ns


@contextmanager
def limited_recorder(chain: Chain, out: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a recorder whose disk is full after 2000 KiB."""
    arguments = f"record {out} --layout {chain.layout_path} --connect {chain.endpoint}"
    limited = f"ulimit -f 2000; exec {sys.executable} -X faulthandler -m skin {arguments}"
    environment = {**os.environ, "SKIN_BUS_DIR": str(chain.supervisor.folder)}
    with subprocess.Popen(["bash", "-c", limited], stderr=subprocess.PIPE, text=True, env=environment) as recorder:
        try:
            yield recorder
        finally:
            recorder.kill()
