"""The signs of life of a service: what it tells its watchdog, and the other services."""

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from canskin.errors import DeniedError
from canskin.fabric import Fabric
from canskin.messages import SERVICES, ServiceStatus
from canskin.session import Stop
from shell.service import ServiceThread
from shell.watchdog import WATCHDOG

#: Time between two signs.
PERIOD_S: Final = 1.0
#: Called in each turn of a loop, with what the service has made so far (`ServiceStatus.made`).
Beat = Callable[[int], None]


def unheard(_made: int) -> None:
    """Beat for nobody: a loop that no service runs."""


class Pulse:
    """Feeds the watchdog, and tells the other services what this one has made and takes, once a second.

    While its loop turns, the service calls `beat`. While it waits for the hub, the wait asks `is_set`.

    Parameters
    ----------
    stop : Stop
        Of the service.
    clock : callable, optional
        Monotonic time in seconds.

    Attributes
    ----------
    fabric : Fabric or None
        Where it tells them.
    """

    def __init__(self, stop: Stop, clock: Callable[[], float] = time.monotonic) -> None:
        self.fabric: Fabric | None = None
        self._stop, self._clock = stop, clock
        self._due_s = self._told_s = clock()
        self._processor_s = time.process_time()
        WATCHDOG.begin()
        self._period_s = min(PERIOD_S, WATCHDOG.limit_s / 2 or PERIOD_S)

    def is_set(self) -> bool:
        """Tell whether the service is to stop; who asks is alive (`canskin.session.Stop`)."""
        self.beat()
        return self._stop.is_set()

    def beat(self, made: int = 0) -> None:
        """Note that the service goes on; cheap."""
        now_s = self._clock()
        if now_s < self._due_s:
            return
        self._due_s = now_s + self._period_s
        WATCHDOG.feed()
        if self.fabric is not None:
            before_s, self._processor_s = self._processor_s, time.process_time()
            load_ratio = (self._processor_s - before_s) / max(now_s - self._told_s, 1e-9)
            self._told_s = now_s
            with suppress(DeniedError):  # of a role that may not: the service itself works
                self.fabric.publish(SERVICES, _status(self.fabric, made, load_ratio))


def _status(fabric: Fabric, made: int, load_ratio: float) -> ServiceStatus:
    clock_offset_ns, clock_error_ns = fabric.clock_ns
    is_thread = isinstance(threading.current_thread(), ServiceThread)
    return ServiceStatus(
        time_ns=time.time_ns(),
        service=fabric.service,
        instance=fabric.instance,
        memory_bytes=_memory_bytes(),
        processor_s=time.thread_time() if is_thread else time.process_time(),
        missed=sum(fabric.missed.counts().values()),
        overruns=fabric.overruns,
        made=made,
        load_ratio=load_ratio,
        clock_offset_ns=clock_offset_ns,
        clock_error_ns=clock_error_ns,
    )


def _memory_bytes() -> int:
    """Return the resident memory of this process (proc_pid_statm(5))."""
    with suppress(OSError):
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0
