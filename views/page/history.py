"""The last minutes of a skin: curves, and frames to be looked at again."""

from collections import deque
from collections.abc import Callable
from typing import Any, Final

from health.snapshot import Moment

PERIOD_S: Final = 0.1
SPAN_S: Final = 300.0
#: The frames kept take this memory at most; of large pictures fewer are kept.
FRAMES_BYTES: Final = 64 << 20
#: Of an instant longer ago no frame is made: nothing came since, and nobody looked.
_LATE_S: Final = 1.0
#: Significant digits are few: forces to a micronewton, times to a microsecond.
_DIGITS: Final = 6


class History:
    """Ten moments a second, and as many frames as fit into `FRAMES_BYTES`. Times are those of the wall clock.

    Parameters
    ----------
    moment, frame : callable
        Return the moment, and the frame, of a time.
    """

    def __init__(self, moment: Callable[[float], Moment], frame: Callable[[float], bytes]) -> None:
        self._moment, self._frame = moment, frame
        self._moments: deque[tuple[float, Moment, int | None]] = deque(maxlen=round(SPAN_S / PERIOD_S))
        self._frames: deque[tuple[float, bytes]] = deque()
        self._bytes = 0
        self._missing: int | None = None
        self._due_s = self._frame_due_s = self._stride_s = 0.0

    def look(self, now_s: float) -> None:
        """Keep what is due up to `now_s`; what has come since is not yet in the state that is asked for moments."""
        if now_s < self._due_s:
            return
        if self._due_s < now_s - SPAN_S:
            self._due_s = now_s
        while self._due_s <= now_s:
            self._keep(self._due_s, is_late=self._due_s < now_s - _LATE_S)
            self._due_s += PERIOD_S

    def since(self, after_s: float) -> dict[str, list[Any]]:
        """Return the moments after a time, column by column."""
        kept = [each for each in self._moments if each[0] > after_s]
        return {
            "time_s": [time_s for time_s, _, _ in kept],
            "force_n": [_rounded(moment.force_n) for _, moment, _ in kept],
            "latency_s": [_rounded(moment.latency_s) for _, moment, _ in kept],
            "load_ratio": [_rounded(moment.load_ratio) for _, moment, _ in kept],
            "lost": [lost for _, _, lost in kept],
            "label": [moment.label for _, moment, _ in kept],
            "mark": [moment.mark for _, moment, _ in kept],
            "contacts": [
                None if moment.contacts is None else [(name, _rounded(force_n)) for name, force_n in moment.contacts]
                for _, moment, _ in kept
            ],
        }

    def frame(self, time_s: float) -> bytes | None:
        """Return the frame nearest to a time; None if nothing was kept near it."""
        near_s, content = min(self._frames, key=lambda each: abs(each[0] - time_s), default=(time_s, None))
        return content if abs(near_s - time_s) <= max(_LATE_S, self._stride_s) else None

    def _keep(self, time_s: float, *, is_late: bool) -> None:
        moment = self._moment(time_s)
        lost = None
        if moment.missing is not None and self._missing is not None:
            lost = max(0, moment.missing - self._missing)  # a gateway that has begun anew counts from 0
        self._missing = moment.missing
        self._moments.append((round(time_s, 3), moment, lost))
        if is_late or time_s < self._frame_due_s:
            return
        content = self._frame(time_s)
        self._stride_s = max(PERIOD_S, SPAN_S * len(content) / FRAMES_BYTES)
        self._frame_due_s = time_s + self._stride_s
        self._frames.append((time_s, content))
        self._bytes += len(content)
        while self._frames[0][0] < time_s - SPAN_S or self._bytes > FRAMES_BYTES:
            self._bytes -= len(self._frames.popleft()[1])


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, _DIGITS)
