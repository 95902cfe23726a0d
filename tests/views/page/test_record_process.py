"""The process of a recorder: how it begins, and what is told if it does not, or ends by itself."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from canskin.errors import RunError
from views.page import record_process
from views.page.record_process import RecorderProcess

FAILS = "import sys; print('record: the disk is full', file=sys.stderr); sys.exit(1)"
#: Ends quietly at a stop signal, as a recorder does.
RUNS = """
import signal, sys
signal.signal(signal.SIGTERM, lambda *_: (print('record: 0 frames and 5 messages in run.mcap'), sys.exit(0)))
print('record: messages', flush=True)
signal.pause()
"""
Make = Callable[[str], RecorderProcess]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Make]:
    made = RecorderProcess(tmp_path, "tcp/127.0.0.1:7447", "palm")

    def of(program: str) -> RecorderProcess:
        def launch(_arguments: list[str], log: object) -> subprocess.Popen[bytes]:
            return subprocess.Popen([sys.executable, "-c", program], stdout=log, stderr=log)  # type: ignore[call-overload,no-any-return]

        monkeypatch.setattr(record_process, "_launch", launch)
        return made

    yield of
    made.close()


def process_of(made: RecorderProcess) -> subprocess.Popen[bytes]:
    assert made._process is not None
    return made._process


def test_a_recorder_that_does_not_begin_tells_why(make: Make) -> None:
    made = make(FAILS)
    with pytest.raises(RunError, match="no recording: the disk is full"):
        made.start(lambda: False)
    assert (made.state, made.notices) == (None, [])
    with pytest.raises(RunError, match="no recording is being made"):
        made.stop()


def test_a_page_that_looks_during_a_start_sees_no_recording_and_keeps_no_notice(make: Make) -> None:
    made = make(RUNS)
    made.start(lambda: made._last_line() != "it said nothing")
    made.stop()
    seen = []

    def look() -> bool:
        seen.append(made.state)
        process_of(made).wait()
        seen.append(made.state)
        return False

    make(FAILS)
    with pytest.raises(RunError, match="no recording: the disk is full"):
        made.start(look)
    assert (seen, made.notices) == ([None, None], [])


def test_a_recorder_that_ends_by_itself_is_told_until_the_next_begins(make: Make) -> None:
    made = make(FAILS)
    made.start(lambda: True)
    process_of(made).wait()
    for _ in range(2):
        assert made.state is None
        (notice,) = made.notices
        assert (notice.level, notice.text) == ("error", "the recording has ended: the disk is full")
    make(RUNS).start(lambda: True)
    assert made.state is not None
    assert made.notices == []


def test_a_recorder_ends_when_it_is_asked_to(make: Make) -> None:
    made = make(RUNS)
    made.start(lambda: made._last_line() != "it said nothing")
    assert made.stop() == "0 frames and 5 messages in run.mcap"
    assert (made.state, made.notices) == (None, [])


def test_recordings_have_names_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "strftime", lambda _: "20261125-120000")
    names = []
    for _ in range(3):
        path = record_process._free(tmp_path, "palm")
        path.touch()
        names.append(path.name)
    assert names == [f"palm-20261125-120000{each}.mcap" for each in ("", "-2", "-3")]
