"""Common parts of all services: log lines, stop signals, real-time scheduling."""

import contextlib
import ctypes
import enum
import errno
import gc
import json
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Final

from canskin.errors import LOG, InputError, Stopped, reasoned
from canskin.peers import ORDINARY, REAL_TIME
from canskin.session import HIGHEST_PORT
from shell.watchdog import WATCHDOG

#: Lowest real-time priority, above all programs without real-time scheduling.
REAL_TIME_PRIORITY: Final = 1
#: Most of the cores that programs at `REAL_TIME_PRIORITY` may take together, with ``--priority auto``.
REAL_TIME_RATIO: Final = 0.9
#: Time between two looks at what they take, seconds.
WATCH_S: Final = 10.0
#: Of loops that let others go first; 0 is that of programs, 19 the most.
NICENESS: Final = 10
#: A service that waits checks the stop signal this often.
LOOK_S: Final = 0.02
#: Environment variable: token of the page, which the viewer draws otherwise.
PAGE_TOKEN: Final = "SKIN_PAGE_TOKEN"  # noqa: S105 - its name
#: Connections that may wait at a socket.
_BACKLOG: Final = 64
#: Who is told what scheduling this process has: each of its services.
_TOLD: Final[list[Callable[[str], None]]] = []
_IS_LINUX: Final = sys.platform.startswith("linux")
#: prctl(2).
PR_SET_PDEATHSIG: Final = 1


class Priority(enum.StrEnum):
    """What services ask for: real time within `REAL_TIME_RATIO` of the cores, real time, ordinary scheduling."""

    AUTO = "auto"
    REALTIME = "realtime"
    NORMAL = "normal"


class StopSignal:
    """A flag set by SIGINT or SIGTERM; services check it in each turn of their loop.

    Not a `threading.Event`: with two signals in a row, the second handler would wait for the lock that the first holds.
    """

    def __init__(self) -> None:
        self._is_set = False
        self._tell: Callable[[], object] = lambda: None

    def install(self, tell: Callable[[], object] = lambda: None) -> "StopSignal":
        """Catch SIGINT and SIGTERM from now on, in the main thread; in a `ServiceThread`, return that of the thread.

        `tell` is called by each signal; it must wait for no lock.
        """
        thread = threading.current_thread()
        if isinstance(thread, ServiceThread):
            return thread.stop
        self._tell = tell
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._caught)
        _end_with_parent()
        return self

    def set(self) -> None:
        """Set the flag."""
        self._is_set = True

    def is_set(self) -> bool:
        """Tell whether the flag is set."""
        return self._is_set

    def wait(self, timeout_s: float) -> bool:
        """Wait for the flag, at most `timeout_s`; tell whether it is set."""
        give_up_s = time.monotonic() + timeout_s
        while not self._is_set and (left_s := give_up_s - time.monotonic()) > 0:
            time.sleep(min(left_s, LOOK_S))
        return self._is_set

    def _caught(self, _number: int, _frame: FrameType | None) -> None:
        self._is_set = True
        WATCHDOG.end()
        self._tell()


class ServiceThread(threading.Thread):
    """A service beside others of its process.

    Parameters
    ----------
    name : str
    serve : callable
        Returns after `stop` is set.
    ended : callable
        Called when `serve` has returned, or raised.

    Attributes
    ----------
    stop : StopSignal
        What `StopSignal.install` returns in this thread.
    error : BaseException or None
        What `serve` has raised.
    """

    def __init__(self, name: str, serve: Callable[[], object], ended: Callable[[], object]) -> None:
        super().__init__(name=name)
        self.stop = StopSignal()
        self.error: BaseException | None = None
        self._serve, self._ended = serve, ended

    def run(self) -> None:
        """Serve."""
        try:
            self._serve()
        except Stopped:
            pass
        except BaseException as error:  # noqa: BLE001 - the main thread raises it
            self.error = error
        finally:
            self._ended()


class RateLimitedLog:
    """Log lines of repeated errors, limited in number: a cut cable must not flood the log.

    The first `BURST` lines of every `PERIOD_S` are printed. Before the next line comes the number of lines that were
    not printed. A verbose process prints every line.
    """

    PERIOD_S: Final = 10.0
    BURST: Final = 5

    def __init__(self, service: str) -> None:
        self._service = service
        self._since_s = float("-inf")
        self._said = self._held_back = 0

    def say(self, text: str) -> None:
        """Print one line, unless `BURST` lines were printed in the present period."""
        now_s = time.monotonic()
        if now_s - self._since_s > self.PERIOD_S:
            if self._held_back:
                say(self._service, f"{self._held_back} more lines like these were not printed")
            self._since_s, self._said, self._held_back = now_s, 0, 0
        if self._said < self.BURST or talks(Talk.VERBOSE):
            self._said += 1
            say(self._service, text)
        else:
            self._held_back += 1


def _end_with_parent() -> None:
    """Have the kernel send SIGTERM when the supervisor that started this process dies (Linux)."""
    parent = os.environ.get("SKIN_PARENT")
    if parent is None or not _IS_LINUX:
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # the supervisor died before this call
        os.kill(os.getpid(), signal.SIGTERM)


def listen(host: str, port: int) -> socket.socket:
    """Open a socket on which a page is served; port 0 is a free port."""
    if not 0 <= port <= HIGHEST_PORT:
        raise InputError(f"--port: expected 0 to {HIGHEST_PORT}, got {port}")
    with reasoned(InputError, f"--host {host}: cannot listen there"):
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise InputError(
                f"port {port} of {host} is in use: give another with --port, or --port 0 for a free one"
            ) from error
        raise InputError(f"--host {host} --port {port}: cannot listen there: {error.strerror or error}") from error
    return listener


def request_real_time(service: str, tell: Callable[[str], None] | None = None) -> str:
    """Request real-time scheduling for every thread of this process, for loops that must keep the SYNC period.

    All threads get real-time scheduling or none does: an ordinary thread of the fabric would starve behind a real-time
    loop, and a loop would wait for the interpreter's lock that the thread holds. A thread that starts later inherits
    the scheduling of the thread that starts it. The kernel keeps a share of each core for other programs, 5 % by
    default (``sched_rt_runtime_us``). Without permission (root, or an ``rtprio`` limit) the scheduling stays as it is,
    and one line says what gives the permission. On a single core it stays, too: there real-time threads take turns of
    100 ms, ordinary threads shorter ones.
    With ``--priority auto``, the default, a thread looks every `WATCH_S` what all programs at this priority take. Above
    `REAL_TIME_RATIO` of the cores the program that takes most goes back to ordinary scheduling, and says so.
    Objects that exist now are excluded from garbage collection, because its pauses would make cycles late.

    Parameters
    ----------
    tell : callable, optional
        Called with what the process has obtained, and again when it goes back to ordinary scheduling.

    Returns
    -------
    str
        What the process has obtained, see `canskin.peers.Peer`.
    """
    gc.collect()
    gc.freeze()
    wanted, tell = _Setting.priority, tell or (lambda _: None)
    can_have = wanted is not Priority.NORMAL and _IS_LINUX and not _has_one_core()
    obtained = REAL_TIME if can_have and _schedule(os.SCHED_RR, REAL_TIME_PRIORITY) else ORDINARY
    why = "as --priority normal asks" if wanted is Priority.NORMAL else way_to_real_time()
    if obtained == REAL_TIME:
        say(service, "scheduling: real time; --priority normal leaves others more")
    else:
        say(service, f"scheduling: ordinary; {why}")
    tell(obtained)
    _TOLD.append(tell)
    if obtained == REAL_TIME and wanted is Priority.AUTO and _TOLD[0] is tell:  # the first of several threads
        threading.Thread(target=_watch, args=(service,), name="share of real time", daemon=True).start()
    return obtained


def _watch(service: str) -> None:
    """Go back to ordinary scheduling while this is the program that takes most, and all take too much."""
    cores, before, before_s = os.cpu_count() or 1, _real_time_s(), time.monotonic()
    while True:
        time.sleep(WATCH_S)
        taken, now_s = _real_time_s(), time.monotonic()
        shares = {each: (taken[each] - before[each]) / (now_s - before_s) for each in taken.keys() & before.keys()}
        if takes_too_much(shares, os.getpid(), cores) and _schedule(os.SCHED_OTHER, 0):
            say(
                service,
                f"scheduling: ordinary, because programs with real time took {sum(shares.values()) / cores:.0%} of"
                f" {cores} cores, expected at most {REAL_TIME_RATIO:.0%}; --priority realtime keeps real time",
            )
            for tell in _TOLD:
                tell(ORDINARY)
            return
        before, before_s = taken, now_s


def takes_too_much(shares: Mapping[int, float], mine: int, cores: int) -> bool:
    """Tell whether a program has to leave real time: all take too much of the cores, and it takes most.

    Parameters
    ----------
    shares : mapping of int to float
        Processor time / wall time of each program with real time, by process.
    mine : int
        The process that asks.
    """
    return mine in shares and sum(shares.values()) > REAL_TIME_RATIO * cores and shares[mine] == max(shares.values())


def _real_time_s() -> dict[int, float]:
    """Return the processor time of each process at `REAL_TIME_PRIORITY`, seconds (proc_pid_stat(5))."""
    tick_s = 1 / os.sysconf("SC_CLK_TCK")
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            fields = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            user, system, priority, policy = (int(fields[at]) for at in (11, 12, 37, 38))
            if policy == os.SCHED_RR and priority == REAL_TIME_PRIORITY:
                found[int(folder.name)] = (user + system) * tick_s
    return found


def _has_one_core() -> bool:
    return len(os.sched_getaffinity(0)) == 1


def way_to_real_time() -> str:
    """Return what gives this process real time, after `request_real_time` has obtained none (sched(7))."""
    if not _IS_LINUX:
        return "real time needs Linux"
    if _has_one_core():
        return "real time needs two cores or more"
    import resource  # of Unix alone

    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if limit == resource.RLIM_INFINITY or limit >= REAL_TIME_PRIORITY:
        return "rtprio allows real time, a filter of system calls or the control group (cpu.rt_runtime_us) refuses it"
    return (
        "for real time: LimitRTPRIO=1 in a systemd unit, --ulimit rtprio=1 of Docker, ulimit -r 1 after the line"
        " '* - rtprio 1' in /etc/security/limits.d/, or setcap cap_sys_nice=ep on Python's file"
    )


def _schedule(policy: int, priority: int) -> bool:
    """Give all threads of this process a scheduling policy; without permission for one thread, to none."""
    done: set[int] = set()
    try:
        # A thread may start another before its own turn comes: look until no thread is new.
        while new := {int(each.name) for each in Path("/proc/self/task").iterdir()} - done:
            for thread in new:
                with contextlib.suppress(ProcessLookupError):  # ended since
                    os.sched_setscheduler(thread, policy, os.sched_param(priority))
            done |= new
    except OSError:
        for thread in done:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        return False
    return True


@contextlib.contextmanager
def ordinary_scheduling() -> Iterator[None]:
    """Take real time from this thread for a while: a process inherits the scheduling of the thread that starts it."""
    if not _IS_LINUX or os.sched_getscheduler(0) == os.SCHED_OTHER:
        yield
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


def yield_processor() -> str:
    """Let other services go first, for a loop whose results count less than theirs; return as `request_real_time`.

    Not those of the same process: they would wait for the interpreter's lock that a thread without processor holds.
    """
    if _IS_LINUX and not isinstance(threading.current_thread(), ServiceThread):
        os.nice(NICENESS)
    return ORDINARY


class Talk(enum.IntEnum):
    """Amount of log lines on stderr."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


class _Setting:
    """Log settings of this process."""

    talk = Talk.NORMAL
    as_json = False
    priority = Priority.AUTO


class _Lines(logging.Handler):
    """Prints the log of the client's modules, such as the fabric, among the lines of this process."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record, in the name of the service that it is of."""
        level = Talk.NORMAL if record.levelno >= logging.WARNING else Talk.VERBOSE
        say(getattr(record, "service", record.name), record.getMessage(), level)


_LINES: Final = _Lines()


def set_talk(talk: Talk, *, as_json: bool = False) -> None:
    """Choose the amount of log lines, and text or JSON; errors of the command line are always printed."""
    _Setting.talk, _Setting.as_json = talk, as_json
    log = logging.getLogger(LOG)
    log.addHandler(_LINES)
    log.setLevel(logging.INFO)
    log.propagate = False


def set_priority(priority: Priority) -> None:
    """Choose what `request_real_time` asks for."""
    _Setting.priority = priority


def given_priority() -> Priority:
    """Return what `request_real_time` asks for."""
    return _Setting.priority


def talks(talk: Talk) -> bool:
    """Tell whether lines of the level `talk` are printed."""
    return _Setting.talk >= talk


def say(service: str, text: str, talk: Talk = Talk.NORMAL) -> None:
    """Print one line for the user on stderr, if lines of the level `talk` are printed."""
    if not talks(talk):
        return
    line = f"{service}: {text}"
    if _Setting.as_json:
        line = json.dumps({"time_s": round(time.time(), 3), "service": service, "text": text}, ensure_ascii=False)
    print(line, file=sys.stderr, flush=True)
