"""The watchdog of this process: who shows no life for too long is ended, and started again by its supervisor.

A unit of systemd names its socket and a limit (sd_notify(3), sd_watchdog_enabled(3)). A container sets the limit alone,
``WATCHDOG_USEC``: the process then ends itself, which a process that is stopped (SIGSTOP) cannot do.
"""

import faulthandler
import os
import socket
import threading
from contextlib import suppress
from typing import Final

from canskin.errors import InputError

#: Part of the limit after which a process ends itself: before its supervisor kills it, its log tells where it hangs.
EARLIER: Final = 0.9
_STDERR: Final = 2


class Watchdog:
    """Passes signs of life on; `WATCHDOG` is that of this process.

    Attributes
    ----------
    limit_s : float
        Longest time between two signs of life; 0 without a limit.
    services : set of str
        Names of threads, each of which must give a sign of life for one of the process; empty: any thread does.
    joins : bool
        Whether a thread is one of `services` from its first sign on.
    """

    def __init__(self) -> None:
        self.limit_s = 0.0
        self.services = set[str]()
        self.joins = False
        self._alive = set[str]()
        self._socket = ""
        self._is_ready = False

    def begin(self) -> None:
        """Take what the supervisor gives this process from the environment: processes that it starts get none of it.

        Further calls change nothing.

        Raises
        ------
        InputError
            If the limit is no number of microseconds.
        """
        self._socket = os.environ.pop("NOTIFY_SOCKET", self._socket)
        limit_us, own = os.environ.pop("WATCHDOG_USEC", None), str(os.getpid())
        if limit_us is not None and not limit_us.isdecimal():
            raise InputError(f"WATCHDOG_USEC={limit_us}: expected microseconds, 0 for no watchdog")
        if os.environ.pop("WATCHDOG_PID", own) == own and limit_us is not None:
            self.limit_s = int(limit_us) / 1e6

    def feed(self) -> None:
        """Give a sign of life of this thread; the process's first one says that it is ready, and begins the watch."""
        name = threading.current_thread().name
        self._alive.add(name)
        if self.joins:
            self.services.add(name)
        if self._alive >= self.services:
            self._alive.clear()
            self._feed()

    def _feed(self) -> None:
        if self._socket:
            self._tell("WATCHDOG=1" if self._is_ready else "READY=1")
        self._is_ready = True
        if self.limit_s:
            # Prints where every thread hangs; needs neither them nor the interpreter's lock.
            faulthandler.dump_traceback_later(EARLIER * self.limit_s, exit=True, file=_STDERR)
            if not self.limit_s:  # a signal has come since
                self.end()

    def compiles(self) -> None:
        """Give a sign of life from the middle of a turn, which lasts because kernels are compiled."""
        if self._is_ready:
            self._feed()

    def end(self) -> None:
        """End the watch: the service stops, and its supervisor waits as long as it likes."""
        self.limit_s = 0.0
        faulthandler.cancel_dump_traceback_later()

    def _tell(self, state: str) -> None:
        address = "\0" + self._socket[1:] if self._socket.startswith("@") else self._socket
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sending:
            sending.sendto(state.encode(), address)


WATCHDOG: Final = Watchdog()
