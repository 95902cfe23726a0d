"""The wall clock against CLOCK_MONOTONIC, the clock of all times between processes."""

import time
from typing import Final, NamedTuple

#: Readings of which the best is taken: a process may be interrupted between two clocks.
READINGS: Final = 3


class WallOffset(NamedTuple):
    """Wall clock minus CLOCK_MONOTONIC, and the bound of its error, nanoseconds."""

    ns: int
    error_ns: int


def wall_offset() -> WallOffset:
    """Read the wall clock between two readings of CLOCK_MONOTONIC."""
    return min((_read() for _ in range(READINGS)), key=lambda read: read.error_ns)


def _read() -> WallOffset:
    before_ns, wall_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
    return WallOffset(wall_ns - (before_ns + after_ns) // 2, (after_ns - before_ns) // 2 + 1)
