"""Who shows no life ends itself, and says where it hangs; who works, waits, compiles or stops is left alone."""

import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from canskin.errors import InputError
from shell import compiled
from shell.watchdog import Watchdog
from tests.processes import PATIENCE_S, Processes

#: A service of a few turns, and then, in a function of its name, what is done in its last one.
SERVICE = """
import threading, time
from shell.pulse import Pulse
from shell.service import StopSignal
stop = StopSignal().install()
pulse = Pulse(stop)
def last_turn():
    {}
for turn in range(3):
    pulse.beat(turn)
last_turn()
"""
#: The last one holds the interpreter's lock.
HANGS = ("time.sleep(600)", "threading.Event().wait()", "sum(range(10**15))")
LIMIT = {"WATCHDOG_USEC": "1000000"}


@pytest.mark.slow
@pytest.mark.parametrize("hang", HANGS)
def test_a_service_that_hangs_ends_itself_and_says_where(hang: str) -> None:
    words = [sys.executable, "-c", SERVICE.format(hang)]
    done = subprocess.run(words, env=os.environ | LIMIT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "in last_turn" in done.stderr


@pytest.mark.slow
def test_a_service_that_was_told_to_stop_has_time_to_end(tmp_path: Path) -> None:
    ending = """print("turns", flush=True)
    while not pulse.is_set():
        time.sleep(0.02)
    time.sleep(1.1)
    pulse.beat()
    time.sleep(5)"""
    with Processes(tmp_path, WATCHDOG_USEC="4000000") as processes:
        processes.start("service", sys.executable, "-c", SERVICE.format(ending))
        processes.await_words("service", "turns")
        assert processes.stop("service", signal.SIGTERM) == 0, processes.log("service").read_text()


@pytest.mark.parametrize("is_abstract", [True, False])
def test_a_supervisor_hears_ready_and_then_signs_of_life(
    is_abstract: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        supervisor.bind("\0" + name if is_abstract else name)
        supervisor.settimeout(PATIENCE_S)
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name if is_abstract else name)
        watchdog = Watchdog()
        watchdog.begin()
        watchdog.compiles()  # no sign yet: it is not ready
        watchdog.feed()
        watchdog.compiles()
        watchdog.feed()
        assert [supervisor.recv(99) for _ in range(3)] == [b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1"]
        assert "NOTIFY_SOCKET" not in os.environ
    watchdog.feed()  # the supervisor starts again: nothing is raised


@pytest.mark.parametrize(("more", "limit_s"), [({}, 600.0), ({"WATCHDOG_PID": "1"}, 0.0)])
def test_the_limit_is_of_the_process_that_it_names(
    more: dict[str, str], limit_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"WATCHDOG_USEC": "600000000", **more}.items():
        monkeypatch.setenv(name, value)
    watchdog = Watchdog()
    watchdog.begin()
    assert watchdog.limit_s == limit_s
    monkeypatch.setenv("WATCHDOG_USEC", "10s")
    with pytest.raises(InputError, match="WATCHDOG_USEC=10s: expected microseconds"):
        watchdog.begin()


@pytest.mark.heavy
def test_each_kernel_that_is_compiled_is_a_sign_of_life(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    signs = []
    monkeypatch.setattr(compiled, "SILENT_S", 0.0)
    monkeypatch.setattr(compiled.COMPILING, "_has_said", False)
    monkeypatch.setattr(compiled.WATCHDOG, "compiles", lambda: signs.append(1))
    inner = compiled.njit()(lambda number: number + 1)
    outer = compiled.njit()(lambda number: inner(number) * 2)
    assert outer(1) == 4
    assert len(signs) >= 4  # begin and end of each
    assert capsys.readouterr().err == "kernels: compiled for this processor, as on every first start\n"


def test_a_process_of_several_services_lives_while_each_of_them_does() -> None:
    watchdog, signs = Watchdog(), list[str]()
    watchdog.services = {"gateway", "view"}
    watchdog._tell = signs.append  # type: ignore[method-assign]
    watchdog._socket = "somewhere"

    def feed(name: str) -> None:
        thread = threading.Thread(target=watchdog.feed, name=name)
        thread.start()
        thread.join()

    for name in ("gateway", "gateway", "view", "view", "view"):
        feed(name)
    assert signs == ["READY=1"]
    feed("gateway")
    assert signs == ["READY=1", "WATCHDOG=1"]
