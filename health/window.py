"""A sliding window of values, and the rate of instants."""

from collections import deque
from typing import Final

#: Most values kept: five seconds at the highest SYNC rate of a layout.
CAPACITY: Final = 10_000


class Window:
    """Values that came in the last `span_s` seconds.

    Examples
    --------
    >>> window = Window(span_s=1.0)
    >>> window.add(10.0, 3.5)
    >>> window.values(10.5), window.values(11.5)
    ([3.5], [])
    """

    def __init__(self, span_s: float) -> None:
        self.span_s = span_s
        self._entries: deque[tuple[float, float]] = deque(maxlen=CAPACITY)

    def add(self, now_s: float, value: float) -> None:
        """Add a value that came at `now_s`."""
        self._entries.append((now_s, value))
        self._forget(now_s)

    def values(self, now_s: float) -> list[float]:
        """Return the values of the last `span_s` seconds, oldest first."""
        self._forget(now_s)
        return [value for _, value in self._entries]

    def mean(self, now_s: float) -> float | None:
        """Return the mean of the values, None without values."""
        values = self.values(now_s)
        return sum(values) / len(values) if values else None

    def _forget(self, now_s: float) -> None:
        while self._entries and self._entries[0][0] <= now_s - self.span_s:
            self._entries.popleft()


class Rate:
    """Instants per second, by the clock of the instants: a burst after a stall is no higher rate.

    Examples
    --------
    >>> rate = Rate(span_s=1.0)
    >>> for instant in range(5):
    ...     rate.add(7.0, instant / 10)  # all came at once
    >>> rate.per_s(7.0), rate.per_s(7.5), rate.per_s(9.0)
    (10.0, 5.0, 0.0)
    """

    def __init__(self, span_s: float) -> None:
        self.span_s = span_s
        self._instants_s: deque[float] = deque(maxlen=CAPACITY)
        self._came_s = 0.0

    def add(self, now_s: float, instant_s: float) -> None:
        """Add an instant, on a clock of its own, that came at `now_s`."""
        if self._instants_s and instant_s < self._instants_s[-1]:  # its clock has begun anew
            self._instants_s.clear()
        self._instants_s.append(instant_s)
        self._came_s = now_s

    def per_s(self, now_s: float) -> float:
        """Return the rate over the last `span_s`; less than two instants have none."""
        instants_s, late_s = self._instants_s, now_s - self._came_s
        while instants_s and instants_s[0] <= instants_s[-1] + late_s - self.span_s:
            instants_s.popleft()
        gaps = len(instants_s) - 1
        if gaps < 1:
            return 0.0
        over_s = instants_s[-1] - instants_s[0]
        # The next one is due after a gap like those before.
        return gaps / max(over_s + max(0.0, late_s - over_s / gaps), 1e-3)
