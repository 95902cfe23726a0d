"""When to try again what has failed."""

import time
from typing import Final

FIRST_S: Final = 0.05
LONGEST_S: Final = 2.0


class Backoff:
    """Doubles the wait after each failure in a row."""

    def __init__(self) -> None:
        self._wait_s = FIRST_S
        self._next_s = 0.0

    @property
    def due(self) -> bool:
        """Whether the next attempt may be made."""
        return time.monotonic() >= self._next_s

    def failed(self) -> None:
        """Wait before the next attempt, twice as long as the last time."""
        self._next_s = time.monotonic() + self._wait_s
        self._wait_s = min(2 * self._wait_s, LONGEST_S)

    def worked(self) -> None:
        """Begin anew with short waits."""
        self._wait_s = FIRST_S

    def give_up(self) -> None:
        """Never try again."""
        self._next_s = float("inf")
