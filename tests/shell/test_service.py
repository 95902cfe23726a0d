"""How a service is told to end."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue

import pytest

from shell.service import REAL_TIME_PRIORITY, REAL_TIME_RATIO, StopSignal, request_real_time, takes_too_much
from tests.processes import PATIENCE_S

MANY_CORES = sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1

#: A handler that a second signal interrupts must not wait for itself; many signals make that likely.
BOMBARDED = """
import sys, time
from shell.service import StopSignal
stop = StopSignal().install()
print("ready", flush=True)
while not stop.wait(60):
    pass
until = time.monotonic() + 0.3
while time.monotonic() < until:
    stop.is_set()
sys.exit(0)
"""


#: Prints what was obtained, and the scheduling of all threads and of a process that is started.
SCHEDULED = """
import json, os, subprocess, sys, threading
from shell.service import ordinary_scheduling, request_real_time
def wait():
    started.release()
    done.wait()
started, done = threading.Semaphore(0), threading.Event()
def start():
    threading.Thread(target=wait).start()
    started.acquire()
start()
told = request_real_time("test")
start()
threads = [os.sched_getscheduler(int(name)) for name in os.listdir("/proc/self/task")]
with ordinary_scheduling():
    child = subprocess.check_output([sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"])
print(json.dumps([told, threads, int(child), os.sched_getscheduler(0)]))
done.set()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="real-time scheduling is asked for on Linux")
def test_all_threads_are_scheduled_alike_and_processes_of_the_service_as_any_other() -> None:
    answer = subprocess.run([sys.executable, "-c", SCHEDULED], capture_output=True, check=True, text=True)
    told, threads, child, own = json.loads(answer.stdout)
    wanted = {"realtime": os.SCHED_RR, "ordinary": os.SCHED_OTHER}[told]
    assert len(threads) >= 3
    assert {own, *threads} == {wanted}
    assert child == os.SCHED_OTHER
    assert answer.stderr.startswith("test: scheduling: ")


@pytest.mark.skipif(sys.platform != "linux", reason="real-time scheduling is asked for on Linux")
def test_on_one_core_scheduling_stays_ordinary() -> None:
    code = f"import os; os.sched_setaffinity(0, {{min(os.sched_getaffinity(0))}})\n{SCHEDULED}"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    told, threads, _, own = json.loads(answer.stdout)
    assert told == "ordinary"
    assert {own, *threads} == {os.SCHED_OTHER}
    assert answer.stderr == "test: scheduling: ordinary; real time needs two cores or more\n"


#: Without the right to any priority, as root too.
WITHOUT_RIGHT = ("prlimit", "--rtprio=0", "setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="NOT TESTED: setpriv is missing (Debian: util-linux)")
@pytest.mark.skipif(not MANY_CORES, reason="NOT TESTED: real time needs two cores")
def test_without_real_time_one_line_says_what_gives_it_and_nothing_is_refused() -> None:
    right = WITHOUT_RIGHT if os.geteuid() == 0 else WITHOUT_RIGHT[:2]
    answer = subprocess.run([*right, sys.executable, "-c", SCHEDULED], capture_output=True, check=True, text=True)
    told, threads, _, own = json.loads(answer.stdout)
    assert told == "ordinary"
    assert {own, *threads} == {os.SCHED_OTHER}
    (line,) = answer.stderr.splitlines()
    for means in ("LimitRTPRIO=1", "--ulimit rtprio=1", "ulimit -r", "setcap cap_sys_nice"):
        assert means in line


@pytest.mark.skipif(not MANY_CORES, reason="NOT TESTED: real time needs two cores")
def test_a_refusal_that_no_limit_explains_is_said_to_be_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("resource.getrlimit", lambda _: (REAL_TIME_PRIORITY, REAL_TIME_PRIORITY))
    assert request_real_time("test") == "ordinary"  # the tests' process is refused, see tests/conftest.py
    assert "cpu.rt_runtime_us" in capsys.readouterr().err


@pytest.mark.parametrize("cores", [2, 8])
def test_the_program_that_takes_most_leaves_real_time_where_all_take_too_much(cores: int) -> None:
    most, rest = 0.6 * REAL_TIME_RATIO * cores, 0.4 * REAL_TIME_RATIO * cores
    assert not takes_too_much({7: most, 8: rest - 0.01}, 7, cores)
    assert takes_too_much({7: most, 8: rest + 0.01}, 7, cores)
    assert not takes_too_much({7: most, 8: rest + 0.01}, 8, cores)
    assert not takes_too_much({8: 0.99 * cores}, 7, cores)


WATCHED = """
import threading, time, shell.service as service
{setting}
service.WATCH_S, service.REAL_TIME_RATIO = 0.05, 1e-9
told = threading.Event()
heard = []
def tell(scheduling):
    heard.append(scheduling)
    if scheduling == "ordinary":
        told.set()
service.request_real_time("test", tell)
while {going}:
    sum(range(10**5))
print(heard)
"""


def test_real_time_is_given_back_where_programs_take_too_much() -> None:
    code = WATCHED.format(setting="", going="not told.is_set()")
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    if answer.stdout == "['ordinary']\n":
        pytest.skip("NOT TESTED: no real time here")
    assert answer.stdout == "['realtime', 'ordinary']\n"
    assert "expected at most" in answer.stderr
    assert "--priority realtime keeps real time" in answer.stderr


def test_of_services_that_ask_at_once_one_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    both, watched = threading.Barrier(2), SimpleQueue[str]()

    class Told(list[Callable[[str], None]]):
        def append(self, tell: Callable[[str], None]) -> None:
            super().append(tell)
            both.wait(PATIENCE_S)

    replaced = {"_TOLD": Told(), "_has_one_core": lambda: False, "_schedule": lambda *_: True, "_watch": watched.put}
    for name, value in replaced.items():
        monkeypatch.setattr(f"shell.service.{name}", value)
    services = [threading.Thread(target=request_real_time, args=(name,)) for name in ("one", "other")]
    for each in services:
        each.start()
    for each in services:
        each.join()
    assert watched.get(timeout=PATIENCE_S) in {"one", "other"}
    assert watched.empty()


def test_priority_normal_asks_for_nothing() -> None:
    code = WATCHED.format(setting="service.set_priority(service.Priority.NORMAL)", going="False")
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert answer.stdout == "['ordinary']\n"
    assert answer.stderr == "test: scheduling: ordinary; as --priority normal asks\n"


@pytest.mark.heavy
def test_many_signals_in_a_row_end_a_service_once() -> None:
    with subprocess.Popen([sys.executable, "-c", BOMBARDED], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        while process.poll() is None:
            process.send_signal(signal.SIGTERM)
        assert process.wait(60) in {0, -signal.SIGTERM}  # the last may come when nobody catches it any more


def test_waiting_ends_when_the_signal_comes_or_the_time_is_over() -> None:
    stop = StopSignal()
    assert not stop.wait(0.01)
    threading.Timer(0.05, stop.set).start()
    began_s = time.monotonic()
    assert stop.wait(60)
    assert time.monotonic() - began_s < 50
    assert stop.wait(0)


def test_signals_are_caught_after_install() -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        stop = StopSignal().install()
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.wait(PATIENCE_S)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
