"""The clock of a skin: the monotonic clock of its gateway's machine, as other machines know it."""

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from canskin.errors import SkinError
from canskin.messages import UNKNOWN_ERROR_NS
from canskin.question import Question
from canskin.text import Told

#: Linux: a random number of each boot, and the number of the clocks that a process sees (time_namespaces(7)).
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
_CLOCKS: Final = Path("/proc/self/ns/time")
#: Time between two looks at the clock, and the longest wait for an answer.
CLOCK_S: Final = 1.0
_HERE_S: Final = 10.0
#: How fast two monotonic clocks part at most: 100 ppm of each crystal, and 500 ppm with which NTP may slew each.
DRIFT_RATIO: Final = 1.2e-3
#: Looks that are kept. The shortest exchange of some seconds is the best one.
_KEPT: Final = 8


class TimeRequest(msgspec.Struct, frozen=True):
    """Asks for the time."""


class TimeReply(Told, frozen=True):
    """The time of a gateway.

    Attributes
    ----------
    mono_ns : int
        Monotonic clock, when the gateway answers.
    machine : str
        See `machine`.
    """

    mono_ns: int
    machine: str


#: The gateway answers.
TIME: Final = Question("time", TimeRequest, TimeReply)


def machine() -> str:
    """Return what processes have in common whose monotonic times can be compared; empty if unknown."""
    try:
        return f"{_BOOT_ID.read_text().strip()} {_CLOCKS.readlink()}"
    except OSError:
        return ""


def time_reply() -> TimeReply:
    """Return the time of this machine."""
    return TimeReply(time.monotonic_ns(), machine())


class SkinClock:
    """Knows by how much the monotonic clock of a gateway's machine is ahead of that of this one.

    All ``*_mono_ns`` of a skin's messages are times of that clock. Half an exchange is the bound of each look (as in
    NTP, RFC 5905, figure 15), and grows by `DRIFT_RATIO`.

    Parameters
    ----------
    of : str, optional
        `machine` of the gateway, if it is known.
    clock_ns : callable, optional
        Monotonic clock of this machine.
    """

    def __init__(self, of: str = "", clock_ns: Callable[[], int] | None = None) -> None:
        self._clock_ns = clock_ns or time.monotonic_ns
        self._is_here = of != "" and of == machine()
        #: Offset, half an exchange, and own time of each look.
        self._looks: deque[tuple[int, int, int]] = deque(maxlen=_KEPT)

    def look(self, ask: Callable[[], TimeReply]) -> None:
        """Ask the gateway once; an answer that does not come, and raises SkinError, leaves what is known."""
        begin_ns = self._clock_ns()
        try:
            reply = ask()
        except SkinError:  # an older gateway, or none at present
            return
        end_ns = self._clock_ns()
        self._is_here = reply.machine != "" and reply.machine == machine()
        half_ns = (end_ns - begin_ns) // 2
        offset_ns = reply.mono_ns - begin_ns - half_ns
        if self._looks and abs(offset_ns - self.known()[0]) > half_ns + self.known()[1]:
            self._looks.clear()  # the gateway was started again on another machine
        self._looks.append((offset_ns, half_ns, end_ns))

    def known(self) -> tuple[int, int]:
        """Return how far the gateway's clock is ahead, and the bound of the error, nanoseconds.

        (0, 0) on the gateway's machine; (0, `UNKNOWN_ERROR_NS`) before the first answer.
        """
        if self._is_here:
            return 0, 0
        now_ns = self._clock_ns()
        looks = [*self._looks]  # another thread adds to them
        bounds = ((half_ns + round(DRIFT_RATIO * (now_ns - at_ns)), offset_ns) for offset_ns, half_ns, at_ns in looks)
        error_ns, offset_ns = min(bounds, default=(UNKNOWN_ERROR_NS, 0))
        return offset_ns, error_ns

    @property
    def period_s(self) -> float:
        """Time until the next look: on the gateway's machine the gateway may only be started again on another one."""
        return _HERE_S if self._is_here else CLOCK_S

    def now_ns(self) -> int:
        """Return the time of now on the gateway's clock; before the first answer that of this machine."""
        return self._clock_ns() + self.known()[0]
