"""What every service does alike: say that it is ready, and end quietly when it is told to."""

import contextlib
import ctypes
import enum
import gc
import json
import os
import signal
import sys
import time
from types import FrameType
from typing import Final

#: Just above everything without real-time scheduling.
REAL_TIME_PRIORITY: Final = 1
#: A service that waits looks this often whether it shall end.
LOOK_S: Final = 0.02
#: prctl(2).
PR_SET_PDEATHSIG: Final = 1


class Stopped(Exception):  # noqa: N818 - no error
    """A service was told to end before it had begun; the command line ends with 0."""


class StopSignal:
    """Set by SIGINT or SIGTERM; services look at it between two turns of their loop.

    A plain flag and no `threading.Event`: a handler that comes while another one holds the event's lock, as with two
    signals in a row, would wait for itself.
    """

    def __init__(self) -> None:
        self._is_set = False

    def install(self) -> "StopSignal":
        """Catch SIGINT and SIGTERM from now on; call it in the main thread."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._caught)
        _end_with_parent()
        return self

    def set(self) -> None:
        """Ask the service to end."""
        self._is_set = True

    def is_set(self) -> bool:
        """Tell whether the service shall end."""
        return self._is_set

    def wait(self, timeout_s: float) -> bool:
        """Wait until the service shall end, at most `timeout_s`; tell whether it shall."""
        give_up_s = time.monotonic() + timeout_s
        while not self._is_set and (left_s := give_up_s - time.monotonic()) > 0:
            time.sleep(min(left_s, LOOK_S))
        return self._is_set

    def _caught(self, _number: int, _frame: FrameType | None) -> None:
        self._is_set = True


class Complaints:
    """Says what goes wrong, but not each time: a cut wire must not flood the log.

    The first `BURST` lines of every `PERIOD_S` are printed; how many were not is said when the next one is. A verbose
    process prints every line.
    """

    PERIOD_S: Final = 10.0
    BURST: Final = 5

    def __init__(self, service: str) -> None:
        self._service = service
        self._since_s = float("-inf")
        self._said = self._held_back = 0

    def complain(self, text: str) -> None:
        """Print one line, unless too many were printed just now."""
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
    if parent is None or not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it died before the call
        os.kill(os.getpid(), signal.SIGTERM)


def be_punctual() -> None:
    """Ask to be run as soon as there is something to do, as the loops that keep the SYNC period need it.

    Real-time scheduling where the system grants it (root, or an ``rtprio`` limit), else nothing. What start-up has
    built is taken out of the garbage collector's sight: its pauses would make cycles late.
    """
    gc.collect()
    gc.freeze()
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME_PRIORITY))


class Talk(enum.IntEnum):
    """How much is said on stderr."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


class _Setting:
    """How this process talks."""

    talk = Talk.NORMAL
    as_json = False


def set_talk(talk: Talk, *, as_json: bool = False) -> None:
    """Choose how much this process says on stderr, and whether as JSON; errors of the command line are always said."""
    _Setting.talk, _Setting.as_json = talk, as_json


def talks(talk: Talk) -> bool:
    """Tell whether lines of the level `talk` are printed."""
    return _Setting.talk >= talk


def say(service: str, text: str, talk: Talk = Talk.NORMAL) -> None:
    """Print one line for the person at the terminal, on stderr, if this process talks as much as `talk`."""
    if not talks(talk):
        return
    line = f"{service}: {text}"
    if _Setting.as_json:
        line = json.dumps({"time_s": round(time.time(), 3), "service": service, "text": text}, ensure_ascii=False)
    print(line, file=sys.stderr, flush=True)
