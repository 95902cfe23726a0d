"""The counter of SYNC (CiA 301, 7.2.5.1): 1 to 240, and then 1 again."""

from typing import Final

#: Largest SYNC counter, and synchronous counter overflow value (1019h): a multiple of two, so turns go on across the
#: overflow, too.
SYNC_OVERFLOW: Final = 240


def next_counter(sync_counter: int) -> int:
    """Return the SYNC counter that follows; 1 follows the overflow value."""
    return sync_counter % SYNC_OVERFLOW + 1
