"""The signs of life of a service: what it tells the other services of itself."""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from canskin.fabric import Fabric
from canskin.messages import SERVICES, ServiceStatus

#: Time between two signs.
PERIOD_S: Final = 1.0
#: Called in each turn of a loop, with what the service has made so far (`ServiceStatus.made`).
Beat = Callable[[int], None]


def unheard(_made: int) -> None:
    """Beat for nobody: a loop that no service runs."""


class Pulse:
    """Tells the other services what this one has made and what it takes, once a second while its loop turns.

    Parameters
    ----------
    clock : callable, optional
        Monotonic time in seconds.

    Attributes
    ----------
    fabric : Fabric or None
        Where it tells them.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.fabric: Fabric | None = None
        self._clock = clock
        self._due_s = clock()

    def beat(self, made: int = 0) -> None:
        """Note that a turn of the loop has ended; cheap."""
        now_s = self._clock()
        if now_s < self._due_s:
            return
        self._due_s = now_s + PERIOD_S
        if self.fabric is not None:
            self.fabric.publish(SERVICES, _status(self.fabric, made))


def _status(fabric: Fabric, made: int) -> ServiceStatus:
    return ServiceStatus(
        time_ns=time.time_ns(),
        service=fabric.service,
        instance=fabric.instance,
        memory_bytes=_memory_bytes(),
        processor_s=time.process_time(),
        missed=sum(fabric.missed.counts().values()),
        overruns=fabric.overruns,
        made=made,
    )


def _memory_bytes() -> int:
    """Return the resident memory of this process (proc_pid_statm(5))."""
    with suppress(OSError):
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0
