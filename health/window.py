"""A sliding window of values."""

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
        self._first_s: float | None = None

    def add(self, now_s: float, value: float) -> None:
        """Add a value that came at `now_s`."""
        if self._first_s is None:
            self._first_s = now_s
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

    def rate_hz(self, now_s: float) -> float:
        """Return the number of values per second; in the first `span_s`, over the time since the first value."""
        self._forget(now_s)
        if self._first_s is None or len(self._entries) < 2:
            return 0.0
        if now_s - self._first_s < self.span_s:
            return (len(self._entries) - 1) / max(now_s - self._first_s, 1e-3)
        return len(self._entries) / self.span_s

    def _forget(self, now_s: float) -> None:
        while self._entries and self._entries[0][0] <= now_s - self.span_s:
            self._entries.popleft()
