"""Least and longest of times that were measured lately."""

from math import inf
from typing import Final

#: Values are kept for this time at least, and for twice this time at most.
SPAN_S: Final = 10.0


class Spread:
    """Least and longest value of the last `SPAN_S` to twice `SPAN_S`, from two numbers of each of two spans."""

    def __init__(self) -> None:
        self._since_s = -inf
        self._before = self._now = (inf, 0.0)

    def add(self, value: float, now_s: float) -> None:
        """Add a value that came at `now_s`."""
        self._turn(now_s)
        least, longest = self._now
        self._now = min(least, value), max(longest, value)

    def of(self, now_s: float) -> tuple[float, float]:
        """Return the least and the longest value; (0, 0) without any."""
        self._turn(now_s)
        least = min(self._before[0], self._now[0])
        return (0.0, 0.0) if least == inf else (least, max(self._before[1], self._now[1]))

    def _turn(self, now_s: float) -> None:
        """Begin a new span when the span of now is over."""
        passed_s = now_s - self._since_s
        if passed_s >= SPAN_S:
            is_next = passed_s < 2 * SPAN_S
            self._before = self._now if is_next else (inf, 0.0)
            self._now, self._since_s = (inf, 0.0), self._since_s + SPAN_S if is_next else now_s
